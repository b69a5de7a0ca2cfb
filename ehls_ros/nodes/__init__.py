"""The rclpy nodes: parameters, messages and timing. The computations are in the other packages."""
