"""Checks a user's problem and filter against their contracts, once, before any work. Every fault is one line."""
