"""The commands: from the words of a line to what they ask for."""
