"""Dynamic force verification of a recording: comparison of its force cycles with their reference, block by block."""
