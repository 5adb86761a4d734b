"""Builds objects from a composed configuration, and checks what a run was expected to find."""
