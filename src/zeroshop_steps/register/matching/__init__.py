"""Which pairs of images match: pair selection, geometric verification, filters of pairs, the view graph."""
