"""What the report's pages are made of: what lies on disk, meshes for the viewer, pictures, plots, advice and HTML."""
