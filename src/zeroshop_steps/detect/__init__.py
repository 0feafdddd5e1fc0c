"""Detection: where the objects of a dataset are in an image."""
