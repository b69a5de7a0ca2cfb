"""From a rig's recordings to its coefficients, with honest uncertainty."""
