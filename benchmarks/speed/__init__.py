"""How fast estlab is, as ratios against fixed references timed in the same run."""
