"""Salient-object networks: which there are, running and training one, and the maps that they leave."""
