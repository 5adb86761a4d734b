"""Hydra: composes a configuration, and reports each of its errors in one line."""
