"""Rasterization of meshes on the processor and on CUDA devices: depth, mask, surface coordinates and colour."""
