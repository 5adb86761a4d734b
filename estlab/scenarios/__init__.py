"""The problems. One file each defines how its truth is simulated or read, its models and its own pictures."""
