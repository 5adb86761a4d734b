"""The filter loop as compiled code, from the models' own source: ``engine=numba``."""
