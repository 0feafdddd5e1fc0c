"""Cameras from silhouettes: coherence, bundle adjustment by rims, and a search for poses without features."""
