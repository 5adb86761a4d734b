"""estlab: a command-line laboratory for nonlinear state estimation."""

from estlab import earlier_names

__version__ = "0.1.0"

earlier_names.find_modules()
