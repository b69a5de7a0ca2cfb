"""First hour of a rig: what it measures and does, step by step, compared with its file."""
