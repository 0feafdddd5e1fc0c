"""ZeroShOP: from pictures of an object to a textured, metric mesh. One folder a stage, one file a method."""

__version__ = "0.1.0"
