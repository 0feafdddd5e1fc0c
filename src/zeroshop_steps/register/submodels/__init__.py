"""Submodels that no matches connect: their alignment by silhouettes, their appearance, their merge."""
