"""Interface to the real rig: DAQ backends, calibration, safety gate, and the emulator that replaces the rig in tests."""
