"""Compiles models written in NumPy's functions to machine code: graph, rules, functions, emit, cache."""
