"""Geometry: cameras, images, meshes and what several stages compute from them."""
