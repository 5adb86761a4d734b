"""estlab: a command-line laboratory for nonlinear state estimation."""

__version__ = "0.1.0"
