"""Which matches the network's cameras and depth bear out: sides that look alike match, too, but lie apart."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.scene.database import read_matches, read_places
from zeroshop_steps.register.vggt.dense_points import unproject
from zeroshop_steps.register.vggt.frames import Frames

APART_SHARE = 0.08
"""Of their distance from the cameras, by which the ends of a match may lie apart: a camera turned by 3 degrees moves its end by 5 %."""
NearMatches = Mapping[tuple[int, int], np.ndarray]
"""By numbers of two images in a database, the first smaller: (M,) bool of their verified matches."""


@dataclass(frozen=True)
class RoughScene:
    """What the network says of a scene.

    Attributes:
        cameras: of the full images.
        frames: what the network saw.
        depth: (S, height, width) along the optical axis, one value a network pixel.
    """

    cameras: list[Camera]
    frames: Frames
    depth: np.ndarray

    def locate(self, view: int, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) points in the world at (N, 2) image positions of a view, and (N,) their depths; not a number where there is no depth."""
        columns, rows = np.rint(self.frames.to_network(xy)).astype(int).T
        height, width = self.depth.shape[1:]
        depth = self.depth[view, np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.float64)
        depth = np.where(depth > 0, depth, np.nan)
        return unproject(self.cameras[view], xy, depth), depth


def find_near(database: Path, scene: RoughScene) -> NearMatches:
    """Which verified matches have both ends at one place, by the network."""
    found = {}
    with pycolmap.Database.open(database) as opened:
        number = {opened.read_image_with_name(camera.name).image_id: view for view, camera in enumerate(scene.cameras)}
        located = {image_id: scene.locate(number[image_id], places) for image_id, places in read_places(opened).items()}
        for (first, second), matches in read_matches(opened):
            one, other = matches.T
            apart = np.linalg.norm(located[first][0][one] - located[second][0][other], axis=1)
            found[first, second] = apart <= APART_SHARE * (located[first][1][one] + located[second][1][other]) / 2
    return found
