"""What stereo and the renderers share: the views of the object, tiles, lists and sums by tile, arrays on a device, colour by direction."""
