"""Segment: masks of the object in the registered images of a scene."""
