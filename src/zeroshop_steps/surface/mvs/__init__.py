"""Multi-view stereo (MVS) by PatchMatch: depth maps, their consistency, the space that they free, and the seeds for training."""
