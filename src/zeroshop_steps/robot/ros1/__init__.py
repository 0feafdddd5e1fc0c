"""ROS 1: its packages for Python, the action's messages, the servers and a client."""
