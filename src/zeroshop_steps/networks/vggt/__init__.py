"""VGGT-1B (Wang et al., VGGT: Visual Geometry Grounded Transformer, CVPR 2025)."""
