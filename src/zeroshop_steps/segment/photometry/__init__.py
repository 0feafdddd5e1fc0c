"""Differences of exposure and white balance between photos, from the colours of points that they share."""
