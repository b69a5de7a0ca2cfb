"""Learning from load cycle to load cycle: position within a cycle, repeating signals, and bounds of the correction."""
