"""How fast estlab is, as ratios against fixed references timed in the same run."""

from estlab.parallel.cores import keep_memory, one_thread_each

# Both as the command does, one of them before NumPy is imported; the references have them too.
one_thread_each()
keep_memory()
