"""Hidden cases for the diagnosis; `python -m benchmarks.diagnosis --help`."""
