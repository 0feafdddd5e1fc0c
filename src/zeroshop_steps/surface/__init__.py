"""Surface: stereo, the optimizers (2DGS, SVRaster) and the raw meshes taken from them."""
