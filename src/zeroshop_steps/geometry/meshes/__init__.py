"""Triangle meshes: the files that hold them, parts and textures, values at vertices, volume and inertia."""
