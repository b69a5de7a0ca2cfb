"""From a rig's recordings to its coefficients and their uncertainty."""
