"""Errors and consistency of an ensemble, with intervals. Arrays in, numbers out; nothing is read or written."""
