"""Leave out matches that the network's cameras and depth contradict: sides that look alike match, and lie apart."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras import Camera, align_to_truth, to_matrix
from zeroshop_steps.geometry.transforms import transform_camera
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
        lost: names of the images whose cameras nothing is known of.
    """

    cameras: list[Camera]
    frames: Frames
    depth: np.ndarray
    lost: frozenset[str] = frozenset()

    def locate(self, view: int, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) points in the world at (N, 2) image positions of a view, and (N,) their depths; not a number where there is no depth."""
        columns, rows = np.rint(self.frames.to_network(xy)).astype(int).T
        height, width = self.depth.shape[1:]
        depth = self.depth[view, np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.float64)
        depth = np.where(depth > 0, depth, np.nan)
        return unproject(self.cameras[view], xy, depth), depth


def find_near(database: Path, scene: RoughScene) -> NearMatches:
    """Which verified matches have both ends at one place, by the network; all of an image whose camera is lost."""
    found = {}
    with pycolmap.Database.open(database) as opened:
        number = {opened.read_image_with_name(camera.name).image_id: view for view, camera in enumerate(scene.cameras)}
        located = {
            image_id: scene.locate(view, opened.read_keypoints(image_id)[:, :2].astype(np.float64).reshape(-1, 2))
            for image_id, view in number.items()
        }
        for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            one, other = geometry.inlier_matches.T
            apart = np.linalg.norm(located[first][0][one] - located[second][0][other], axis=1)
            near = apart <= APART_SHARE * (located[first][1][one] + located[second][1][other]) / 2
            found[first, second] = near | any(scene.cameras[number[end]].name in scene.lost for end in (first, second))
    return found


def keep_near(database: Path, near: NearMatches) -> None:
    """Take the other verified matches out of a database."""
    with pycolmap.Database.open(database) as opened:
        for (first, second), kept in near.items():
            if not kept.all():
                geometry = opened.read_two_view_geometry(first, second)
                geometry.inlier_matches = geometry.inlier_matches[kept]
                opened.update_two_view_geometry(first, second, geometry)


def refine_scene(scene: RoughScene, adjusted: pycolmap.Reconstruction) -> RoughScene:
    """The scene with the cameras of a model, moved to where the network's are, so that its depth goes on to fit them."""
    lens = adjusted.cameras[1]
    found = {}
    for image in adjusted.images.values():
        if image.has_pose:
            found[image.name] = Camera(image.name, lens.width, lens.height, lens.calibration_matrix(), to_matrix(image.cam_from_world()))
    rough_from_adjusted = align_to_truth((found[camera.name], camera) for camera in scene.cameras if camera.name in found)
    moved = {name: transform_camera(camera, rough_from_adjusted) for name, camera in found.items()}
    lost = frozenset(camera.name for camera in scene.cameras if camera.name not in moved)
    return replace(scene, cameras=[moved.get(camera.name, camera) for camera in scene.cameras], lost=lost)
