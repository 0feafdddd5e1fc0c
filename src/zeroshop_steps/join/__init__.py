"""Join: the cameras of several passes of one object, in which it lay differently, in one frame."""
