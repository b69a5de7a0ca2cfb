"""Benchmarks: scripts that print their tables, run from the top folder of the source tree."""
