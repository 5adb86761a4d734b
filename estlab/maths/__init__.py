"""Small-matrix algebra, beliefs, spaces and transforms on components-first arrays. No units, no config."""
