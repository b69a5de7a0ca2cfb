"""Numbers of a control law for a rig."""
