"""Pose: where exactly a detected object is, and how it is turned."""
