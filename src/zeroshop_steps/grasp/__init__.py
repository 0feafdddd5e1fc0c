"""Where and how a gripper can take an object: grasps on its measured surface, ranked and checked for collisions."""
