"""Capture: where the pictures of an object come from. Virtual objects and their rendered scenes, or the user's own photos."""

METHODS = ("demo_objects", "bop_models", "raycast", "blenderproc", "blender_environment", "board_scene", "film", "photos", "video")
