"""Campaigns of many experiments from one file: variations, execution of the runs, storage of the results."""
