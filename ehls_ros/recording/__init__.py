"""Reads and writes bags and CSV, MAT and Parquet files as one Trajectory type."""
