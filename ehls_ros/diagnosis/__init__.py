"""What the simulation of a rig gets wrong, why, and what mending it gains."""
