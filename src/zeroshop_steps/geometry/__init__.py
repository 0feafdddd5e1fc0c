"""Geometry that several stages share: cameras, images, meshes, the support plane and what the photos see."""
