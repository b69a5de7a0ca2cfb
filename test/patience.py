"""Timeout of the tests for expected events."""

PATIENCE = 600.0
"""Longest wait for an event [s]. It only ends a hung test: a slow and loaded machine must stay well below it."""
