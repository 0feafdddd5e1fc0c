"""Printed boards of markers that give the scale: ChArUco boards and AprilTags, with the files that describe them."""
