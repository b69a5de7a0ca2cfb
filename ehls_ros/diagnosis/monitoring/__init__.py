"""The rig watched while it runs: statistics of short blocks against a baseline, and when their sum is no chance."""
