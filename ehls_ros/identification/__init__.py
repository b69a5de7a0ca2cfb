"""Identification of a rig's coefficients and their uncertainty from recordings."""
