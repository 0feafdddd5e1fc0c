"""Segment Anything with a small image encoder (Zhang et al. 2023, MobileSAM): masks of what points, a box or a rough mask ask for."""
