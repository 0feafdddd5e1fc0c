"""Detect the objects of a dataset in images."""
