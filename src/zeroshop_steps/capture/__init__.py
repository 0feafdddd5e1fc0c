"""Capture: the user's own photos and videos, checked and copied."""
