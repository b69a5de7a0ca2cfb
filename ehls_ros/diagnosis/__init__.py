"""What the model of a rig gets wrong, why, and what correcting it gains."""
