"""ZeroShOP: from pictures of an object to a textured, metric mesh. One folder a stage, one file a method."""

import os
import zlib  # noqa: F401

__version__ = "0.43.0"

# Open3D carries a TBB that numba finds too old and warns of; ask for OpenMP first.
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp workqueue tbb")

# pycolmap exports a zlib of its own. Loaded before the system's, it takes over half of that one's calls, and the next PNG that
# OpenCV writes corrupts the heap; `import zlib`, above, loads the system's first.
