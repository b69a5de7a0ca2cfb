"""The monitor on simulated rigs: false alarms, delay and right names, beside simpler detectors, and what it costs."""
