"""Errors and consistency of an ensemble, with intervals. Takes arrays and returns numbers; reads and writes nothing."""
