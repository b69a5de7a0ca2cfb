"""Electro-hydraulic load simulator: plant, friction, force control and the ROS 2 graph around them."""

__version__ = "0.1.0"
