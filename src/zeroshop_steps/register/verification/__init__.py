"""Checks of a model, and what they found: matches, silhouettes, covisibility, photometry, coverage."""
