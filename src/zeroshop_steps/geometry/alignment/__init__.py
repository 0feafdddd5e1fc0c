"""Alignment of surfaces: sampled points, distances, and iterated closest points (ICP) with scale."""
