"""A rig watched while it runs, or its recordings watched as if it ran."""
