"""Dynamic force verification of a recording: how its cycles of force compare with their reference, block by block."""
