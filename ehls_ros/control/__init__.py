"""Force controllers, friction observers, reference and disturbance signals, theoretical bounds."""
