"""Pinhole cameras and COLMAP's models on disk, transforms, viewpoints, and the registered views of an object."""
