"""The rclpy nodes: parameters, messages and timing; what they compute lives in the other packages."""
