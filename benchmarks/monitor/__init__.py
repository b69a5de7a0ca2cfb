"""The monitor on simulated rigs: false alarms, delay and correct names, compared with simpler detectors, and its cost."""
