"""ROS 2: a thin adapter of the same servers to rclpy, which is installed with ROS 2 and not here."""
