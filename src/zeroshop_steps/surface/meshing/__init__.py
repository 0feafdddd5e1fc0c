"""From a trained model to a raw mesh: what all methods share, depths and densities on a lattice, and the silhouettes."""
