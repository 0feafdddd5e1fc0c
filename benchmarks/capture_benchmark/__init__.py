"""The benchmark of captures: what masks and meshes come out of captures as people take them. See docs/benchmark.md."""
