"""Messages of ROS, of ROS 1 and ROS 2 alike, read and written without ROS."""
