"""Scanning with a camera that a robot moves: recording stops, what has been measured, where to look next, and arms."""
