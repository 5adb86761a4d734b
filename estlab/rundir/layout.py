"""The names of the files of a run directory, and the largest size at which they are read."""

CONFIG, OVERRIDES, RUN, STATUS, LOG = "config.yaml", "overrides.yaml", "run.json", "status.json", "log.txt"
ERRORS, NEES, NIS, NOTES, METRICS = "errors.csv", "nees.csv", "nis.csv", "notes.csv", "metrics.csv"
TESTS, VERDICTS, COVERAGE, HISTOGRAMS = "tests.csv", "verdicts.csv", "coverage.csv", "histograms.csv"
COMPARISON, RUNS = "comparison.csv", "runs.csv"
ESTIMATES, PLOTS, EXPECTATIONS, PART = "estimates.npz", "plots", "expectations.csv", "part.npz"
PLUGINS = "plugins"  # the folder of the source of plugins

# A larger file was not written by a run, or would fill the memory.
CONFIG_BYTES, RECORD_BYTES, TABLE_BYTES, ARRAY_BYTES = 2**18, 2**22, 2**30, 2**33
