"""Evaluate: how good cameras, masks and meshes are, by photos alone and against the truth, and the grade that follows."""
