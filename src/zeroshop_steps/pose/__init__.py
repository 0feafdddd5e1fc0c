"""Estimate the pose of detected objects: position and orientation."""
