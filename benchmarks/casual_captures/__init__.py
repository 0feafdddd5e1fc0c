"""Rendered captures as people take them at home: the models, the rooms, and the photos, with their truth."""
