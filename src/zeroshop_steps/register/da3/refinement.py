"""From rough cameras and SIFT's matches to a model of these matches: adjusted in rounds, triangulated, completed.

The network's cameras and depth tell which matches may be right: sides that look alike match, too, but lie apart.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.mapping.mapper import triangulate_points
from zeroshop_steps.register.mapping.reregistration import register_again
from zeroshop_steps.register.matching.network_matches import label_tracks
from zeroshop_steps.register.pipeline import LEAST_COMMON_SHARE
from zeroshop_steps.register.scene.database import has_wide_lens, read_matches, read_places
from zeroshop_steps.register.scene.image_set import MIN_IMAGES, ImageSet
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.register.vggt.bundle import adjust_cameras, drop_weak_images
from zeroshop_steps.register.vggt.feed_forward import unproject
from zeroshop_steps.register.vggt.frames import Frames
from zeroshop_steps.register.vggt.tracks import TrackObservations

LENS = "SIMPLE_RADIAL"  # as the database has it
LEAST_NEAR = 0.1
"""Of the matches, by the network: with cameras that are off by 3 degrees half of the right ones are near, with wrong ones hardly any."""
MAX_TRACKS = 20_000  # for the first adjustment; triangulation takes all
APART_SHARE = 0.08
"""Of their distance from the cameras, by which the ends of a match may lie apart: a camera turned by 3 degrees moves its end by 5 %."""
NearMatches = Mapping[tuple[int, int], np.ndarray]
"""By numbers of two images in a database, the first smaller: (M,) bool of their verified matches."""


class TooFewMatches(RegistrationFailed):
    """The matches hold too few images."""


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


def start_from_cameras(
    scene: RoughScene, image_set: ImageSet, options: Da3Options, database: Path
) -> tuple[pycolmap.Reconstruction, dict[str, Any]]:
    """A model of the matches in a database, and entries of the record, from estimates of the cameras and depth of all images.

    The estimates may be off by degrees, so that matches are first laid out as tracks, and cameras adjusted under an error limit that
    shrinks. Then COLMAP triangulates all matches, and registers the images that were lost.

    Args:
        scene: in the order of the images.
        image_set: what they show.
        options: of the method.
        database: features and verified matches; what is written on the way lies beside it.

    Raises:
        TooFewMatches: too few images are held by matches.
        RegistrationFailed: the estimates contradict most matches.
    """
    structure, folder, count = options.colmap.structure, image_set.images[0].parent, len(image_set.images)
    if has_wide_lens(database):
        raise RegistrationFailed(
            "the matches show a wide lens (an action camera, a 0.5x lens or a fisheye); Depth Anything 3 expects pictures without such a"
            " distortion: use the registration colmap, which finds it",
            {},
        )
    share = LEAST_COMMON_SHARE if structure.leave_out and not image_set.film else structure.min_share
    needed = max(structure.min_images, math.ceil(share * count))
    every, near = gather_tracks(database, image_set.names), find_near(database, scene)
    rich, near_share = int((every.seen.sum(1) >= options.min_observations).sum()), measure_share(near)
    entries = {"near_share": round(near_share, 3)}
    if rich >= needed and near_share < LEAST_NEAR:
        raise RegistrationFailed(
            f"the network's cameras contradict {1 - near_share:.0%} of the matches, which connect {rich} of {count} images: it is wrong"
            " about these pictures; use the registration colmap",
            entries,
        )
    # Wrong matches are fewer among the near ones; but where cameras are very rough, right ones are, too.
    for tracks in (gather_tracks(database, image_set.names, near), every):
        adjusted = adjust_cameras(scene.cameras, tracks, LENS, options.max_error_px)
        adjusted = drop_weak_images(adjusted, options.min_observations, options.max_error_px)
        if (held := adjusted.num_reg_images()) >= needed:
            break
    if held >= MIN_IMAGES and adjusted.num_points3D():
        poses = {Path(image.name).stem: image.cam_from_world() for image in adjusted.images.values() if image.has_pose}
        model = triangulate_points(database, image_set, poses, structure.seed, lens=adjusted.cameras[1])
        if held < count:
            model = register_again(model, [], database, folder, database.parent, structure.seed)
        held = model.num_reg_images()
    if held < needed:
        raise TooFewMatches(f"matches hold {held} of {count} images, at least {needed} are needed", entries)
    return model, entries


def measure_share(near: NearMatches) -> float:
    """The share of the matches that are near; 0 where there are none."""
    total = sum(len(kept) for kept in near.values())
    return sum(int(kept.sum()) for kept in near.values()) / max(total, 1)


def gather_tracks(database: Path, names: list[str], kept: NearMatches | None = None) -> TrackObservations:
    """What verified matches, or the `kept` ones, connect in at least three images.

    Where they connect two places of one image, that image does not see it.
    """
    with pycolmap.Database.open(database) as opened:
        number = {opened.read_image_with_name(name).image_id: index for index, name in enumerate(names)}
        places, matches = read_places(opened), {}
        for ends, verified in read_matches(opened):
            inliers = verified if kept is None else verified[kept[ends]]
            if len(inliers):
                matches[number[ends[0]], number[ends[1]]] = (inliers[:, 0], inliers[:, 1])
    keypoints = [places[image_id] for image_id in number]
    counts = [len(points) for points in keypoints]
    track, view = label_tracks(counts, matches), np.repeat(np.arange(len(names)), counts)
    places, which, times = np.unique(track.astype(np.int64) * len(names) + view, return_inverse=True, return_counts=True)
    once = np.flatnonzero(times[which] == 1)
    views = np.bincount(places[times == 1] // len(names), minlength=1)
    long = np.flatnonzero(views >= MIN_IMAGES)
    long = long[np.unique(np.linspace(0, max(len(long) - 1, 0), min(MAX_TRACKS, len(long))).astype(int))]
    column = np.full(len(views), -1)
    column[long] = np.arange(len(long))
    seen = np.zeros((len(names), len(long)), bool)
    xy = np.zeros((*seen.shape, 2))
    once = once[column[track[once]] >= 0]
    at = view[once], column[track[once]]
    seen[at], xy[at] = True, np.concatenate(keypoints)[once]
    return TrackObservations(xy, seen, np.zeros((len(long), 3), np.uint8))
