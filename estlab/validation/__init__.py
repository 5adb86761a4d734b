"""Checks what a user's problem and filter return against their contracts, once, before any work. Every fault is one
line.
"""
