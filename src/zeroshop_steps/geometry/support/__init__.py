"""What an object stands on: the plane below it, in a masked view or a whole scene, and its stable placements."""
