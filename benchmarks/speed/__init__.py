"""How fast estlab is, as ratios against fixed references timed in the same run."""

from estlab.cores import one_thread_each

one_thread_each()  # before NumPy is imported, as the command does
