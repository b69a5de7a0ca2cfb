"""Strangers: whole rigs that the package has never met, in all modes; `python -m benchmarks.strangers --help`."""
