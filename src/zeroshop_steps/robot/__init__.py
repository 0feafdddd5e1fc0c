"""From models to a robot: recognition behind the servers of ROS, bags, and a robot in simulation."""
