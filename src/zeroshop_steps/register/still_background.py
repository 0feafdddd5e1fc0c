"""Photos of an object on a turntable before a background that stands still: cameras would follow the background.

What stands still in the picture while the object turns has matches that do not move. Cameras that are found from the others see the object
from all around, as if the camera had moved.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.register.image_set import ImageSet
from zeroshop_steps.register.sift import make_verification_options, write_pairs

STILL_PX = 4.0  # per 1000 px of the longer side: matches that move less stand still
STILL_SHARE = 0.3
"""Share of the matches of the median pair that stand still: nearly none where the camera moves, most before a background with texture."""
STILL_PAIR, STILL_PAIRS, LEAST_PAIRS = 0.7, 0.02, 3
"""Before a background with little texture, only a few pairs match by it, but these contradict all others. A pair stands still if so many of
its matches do; a share of so many pairs, and at least three, are no photos that were taken twice from one place."""
STILL_REMEDY = "move the camera instead, hang a plain cloth behind the object, or give masks and take the scene video_segmented"
LEAST_MATCHES = 30  # of a pair that tells anything


@dataclass(frozen=True)
class StillMatches:
    """Verified matches that stand still.

    Attributes:
        share: of those of the median pair.
        pairs: share of the pairs that stand still; 0 if they are fewer than `LEAST_PAIRS`.
    """

    share: float
    pairs: float

    @property
    def are_background(self) -> bool:
        """Whether the background stood still while the object turned."""
        return self.share > STILL_SHARE or self.pairs > STILL_PAIRS

    def describe(self) -> str:
        """What was found, for the user."""
        how = f"{self.share:.0%} of what matches" if self.share > STILL_SHARE else f"in {self.pairs:.0%} of the pairs, what matches"
        return f"the background stands still in the photos while the object turns ({how} does not move)"


def measure_still(database: Path, image_set: ImageSet) -> StillMatches:
    """How much stands still of the verified matches of all pairs of images of one size with enough matches."""
    shares = []
    with pycolmap.Database.open(database) as opened:
        images = {image.image_id: image.name for image in opened.read_all_images()}
        points = {image_id: opened.read_keypoints(image_id)[:, :2] for image_id in images}
        sizes = dict(zip(image_set.names, image_set.sizes_px, strict=True))
        for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            matches = geometry.inlier_matches
            if len(matches) < LEAST_MATCHES or sizes[images[first]] != sizes[images[second]]:
                continue
            moved_px = np.linalg.norm(points[first][matches[:, 0]] - points[second][matches[:, 1]], axis=1)
            shares.append(float((moved_px < STILL_PX * image_set.scales[images[first]]).mean()))
    if not shares:
        return StillMatches(0.0, 0.0)
    still = np.array(shares) > STILL_PAIR
    return StillMatches(float(np.median(shares)), float(still.mean()) if still.sum() >= LEAST_PAIRS else 0.0)


def verify_without_still(database: Path, image_set: ImageSet, seed: int) -> None:
    """Verify the matches of all pairs anew, without those that stand still; changes the database in place."""
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        pairs = [pycolmap.pair_id_to_image_pair(pair_id) for pair_id in opened.read_all_matches()[0]]
        opened.clear_two_view_geometries()
    listed = write_pairs(database, [(names[first], names[second]) for first, second in pairs])
    options = make_verification_options(seed)
    options.filter_stationary_matches = True
    options.stationary_matches_max_error = STILL_PX * max(image_set.scales.values())
    pycolmap.verify_matches(database, listed, options)
