"""Metric height: how high the object stands above its support plane, and how many metres a unit of the registration is."""
