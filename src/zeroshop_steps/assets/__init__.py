"""A finished mesh for robots and simulators: a body with mass, inertia and convex parts, and the files that describe it to each."""
