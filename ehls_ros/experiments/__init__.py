"""Experiment specs, the runner without ROS, and metrics."""
