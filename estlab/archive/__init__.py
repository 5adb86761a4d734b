"""Run directories that are finished, read as data alone, whoever wrote them."""
