"""Refinement of cameras that are known: by patches, by silhouettes, and how surely they are held."""
