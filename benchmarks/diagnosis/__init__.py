"""Hidden cases against the diagnosis; `python -m benchmarks.diagnosis --help`."""
