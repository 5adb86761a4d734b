"""Tables, plots and terminal output, drawn from a run directory alone."""
