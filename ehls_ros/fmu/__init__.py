"""Functional Mock-up Units (FMI 2.0 and 3.0): export of compiled models, and plants imported from FMUs."""
