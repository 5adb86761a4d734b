"""What is compiled: the Gaussian family in numbers."""
