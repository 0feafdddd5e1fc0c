"""Images: their files, pixels and colours, how much two of them overlap, and contact sheets of many."""
