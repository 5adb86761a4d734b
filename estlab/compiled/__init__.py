"""Models written in NumPy's functions, traced once, as code of the processor: graph, rules, functions, emit, cache."""
