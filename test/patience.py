"""How long a test waits for what has to come."""

PATIENCE = 600.0
"""Longest wait for an event [s]. It only ends a test that hangs: a slow and loaded machine has to come nowhere near it."""
