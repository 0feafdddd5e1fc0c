"""FoundationPose's two networks (Wen et al., FoundationPose: Unified 6D Pose Estimation and Tracking of Novel Objects, CVPR 2024)."""
