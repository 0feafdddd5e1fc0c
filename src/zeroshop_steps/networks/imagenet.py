"""ImageNet's colours, by which photos are normalised for networks that were trained on it."""

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of red, green and blue, from 0 to 1."""
LEVEL_MEAN, LEVEL_DEVIATION = (tuple(round(255 * value, 3) for value in values) for values in (MEAN, DEVIATION))
"""The same from 0 to 255."""
