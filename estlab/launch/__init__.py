"""Hydra: composing a configuration, and its errors in one line each."""
