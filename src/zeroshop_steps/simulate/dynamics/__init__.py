"""The simulated world in MuJoCo: its numbers, bodies, the gripper, and lifting."""
