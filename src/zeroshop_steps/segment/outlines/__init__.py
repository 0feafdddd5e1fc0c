"""Cutting masks along edges: graph cut, where exactly an outline lies, and windows around small objects."""
