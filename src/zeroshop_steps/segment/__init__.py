"""Segment: masks of the object in the registered images of a scene."""

METHODS = ("given", "support_plane", "grounded_sam", "object_capture", "mask_error")
