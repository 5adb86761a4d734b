"""The names of the files of a run directory, and the largest size at which they are read."""

CONFIG, OVERRIDES, RUN, STATUS, LOG = "config.yaml", "overrides.yaml", "run.json", "status.json", "log.txt"
ERRORS, NEES, NIS, NOTES, METRICS = "errors.csv", "nees.csv", "nis.csv", "notes.csv", "metrics.csv"
TESTS, VERDICTS, COVERAGE, HISTOGRAMS = "tests.csv", "verdicts.csv", "coverage.csv", "histograms.csv"
COMPARISON, RUNS = "comparison.csv", "runs.csv"
ESTIMATES, PLOTS, EXPECTATIONS, PART = "estimates.npz", "plots", "expectations.csv", "part.npz"
PLUGINS = "plugins"  # the folder of the source of plugins
REPORT = "report.html"  # of a run's directory and of a sweep's

# Of a sweep's directory; OUTPUT of its jobs'.
PLAN, LOCK, STOP, ATTEMPTS, OUTPUT = "sweep.json", ".lock", ".stop", "attempts", "output.txt"
SWEEP, GROUPS, FAILURES, TUNING = "sweep.csv", "groups.csv", "failures.csv", "tuning.csv"

# A larger file was not written by a run, or would fill the memory.
CONFIG_BYTES, RECORD_BYTES, TABLE_BYTES, ARRAY_BYTES = 2**18, 2**22, 2**30, 2**33
