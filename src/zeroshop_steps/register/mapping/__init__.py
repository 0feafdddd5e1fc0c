"""Cameras and points from verified matches: incremental mapping, re-registration, bundle adjustment, triangulation."""
