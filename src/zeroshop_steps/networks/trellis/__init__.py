"""TRELLIS (Xiang et al., Structured 3D Latents for Scalable and Versatile 3D Generation, CVPR 2025) in plain PyTorch.

Two flows make a shape from pictures: one says which voxels of a coarse grid hold surface, one gives each of them a latent. A decoder
turns the latents into a finer grid of signed distances, of which `flexible_surface` takes the mesh. Parameters have the names and
shapes of the published checkpoints.
"""
