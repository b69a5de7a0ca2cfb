"""Test programmes: blocks of load cycles, ramps, dwells and recorded loads, how they are run, and the count of their cycles."""
