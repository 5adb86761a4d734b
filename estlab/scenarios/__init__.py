"""The problems: one file each says how its truth is made or read, its models and its own pictures."""
