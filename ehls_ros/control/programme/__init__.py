"""Test programmes: blocks of load cycles, ramps, dwells and recorded loads, their execution, and the count of load cycles."""
