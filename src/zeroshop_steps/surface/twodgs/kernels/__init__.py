"""The kernels of 2D Gaussian Splatting, for the CPU and for CUDA: projection, tiles, blending forward and backward."""
