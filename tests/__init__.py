"""Whatever imports the tests keeps NumPy's linear algebra to one thread, as the command line does: cores are shared."""

from estlab.parallel.cores import one_thread_each

one_thread_each()
