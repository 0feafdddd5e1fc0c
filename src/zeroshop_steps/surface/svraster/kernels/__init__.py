"""The kernels of sparse voxels, for the CPU and for CUDA: projection, tiles, blending forward and backward."""
