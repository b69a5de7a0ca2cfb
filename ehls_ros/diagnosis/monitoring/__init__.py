"""Online monitoring of a running rig: statistics of short blocks against a baseline, and a test for significant change."""
