"""How good cameras, masks and meshes are, judged by the photos alone and against the truth, and the resulting grade."""
