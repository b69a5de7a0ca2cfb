"""The way to the real rig: DAQ backends, calibration, safety gate, and the emulator that stands in for it."""
