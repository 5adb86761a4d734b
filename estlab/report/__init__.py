"""Tables, plots and terminal output, drawn only from a run directory."""
