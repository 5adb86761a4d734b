"""Filters: a prior, a prediction, an update; and the loop over time that applies them."""
