"""Bags and CSV files to and from one Trajectory type."""
