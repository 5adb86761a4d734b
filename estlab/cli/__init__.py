"""The commands: each parses its words and does what they ask."""
