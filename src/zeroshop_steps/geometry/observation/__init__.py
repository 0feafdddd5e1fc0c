"""What photos see of an object: visibility, the visual hull, and how each vertex of a mesh is supported."""
