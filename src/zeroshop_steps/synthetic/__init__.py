"""Synthetic data: models made by code or from BOP, and rendered captures, films and test scenes of them with exact truth."""
