"""The parts of the report's pages: the index of the results, meshes for the viewer, pictures, plots, advice and HTML."""
