"""The BOP benchmark: its files, pose errors and scores; alignment of meshes with true models, and their export."""
