"""Lengths: meshes are in millimetres; heights, robots and networks use metres."""

MM_PER_M, M_PER_MM = 1000.0, 0.001
