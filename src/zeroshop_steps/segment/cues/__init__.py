"""Cues: what tells the object from its surroundings, a file each.

A cue is prepared once for all views, since most cues compare them: `prepare(scene, guess)` returns a function from the number of a view
to its channels, (h, w) float32 of about -1 to 1, named by `CHANNELS`; or None where the cue knows nothing. A channel that ends in
`_known` is 1 where the cue knows something and 0 elsewhere. What the channels mean together is learned (segment/cues/fusion.py).
"""

MOST_ODDS = 3.0  # log odds of a pixel at most: neighbours repeat each other's errors
