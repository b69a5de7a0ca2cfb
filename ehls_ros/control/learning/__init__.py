"""What is learnt from load cycle to load cycle: where a cycle stands, what repeats, and how much of it may be corrected."""
