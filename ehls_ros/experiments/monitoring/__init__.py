"""Monitoring of a running rig, or of its recordings in replay."""
