"""Geometry that several stages share: images, cameras, meshes, rendering, alignment, what photos see, and what objects stand on."""
