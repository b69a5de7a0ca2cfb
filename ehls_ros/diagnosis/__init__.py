"""Diagnosis of a rig's model: its errors, their causes, and the gain from correcting them."""
