"""From rough cameras and SIFT's matches to a model of these matches: adjusted in rounds, triangulated, completed."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.register.da3.guided_matches import RoughScene, leave_out_contradicted
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.image_set import ImageSet
from zeroshop_steps.register.mapping import make_mapping_options
from zeroshop_steps.register.match_database import label_tracks
from zeroshop_steps.register.record import RegistrationFailed
from zeroshop_steps.register.repair import register_again
from zeroshop_steps.register.structure import LEAST_COMMON_SHARE
from zeroshop_steps.register.vggt.bundle import MIN_VIEWS, adjust_cameras, drop_weak_images
from zeroshop_steps.register.vggt.tracks import TrackObservations

LENS = "SIMPLE_RADIAL"  # as the database has it
LEAST_STAYED = 1 / 3
"""Of the matches, that right cameras let stay: on plain grounds, where sides that look alike match, 56 and 74 % of them are right."""
MAX_TRACKS = 20_000  # for the first adjustment; triangulation takes all


class TooFewMatches(Exception):
    """The matches hold too few images."""


def start_from_cameras(
    scene: RoughScene, image_set: ImageSet, options: Da3Options, figures: dict[str, Any], database: Path
) -> pycolmap.Reconstruction:
    """A model of the matches in a database, from estimates of the cameras and depth of all images.

    The estimates may be off by degrees, so that matches are first laid out as tracks, and cameras adjusted under an error limit that
    shrinks. Then COLMAP triangulates all matches, and registers the images that were lost.

    Args:
        scene: in the order of the images.
        image_set: what they show.
        options: of the method.
        figures: the record so far; completed in place.
        database: features and verified matches, of which those are taken out that the estimates contradict; what is written on the
            way lies beside it.

    Raises:
        TooFewMatches: too few images are held by matches.
        RegistrationFailed: the estimates contradict most matches.
    """
    structure, folder, count = options.colmap.structure, image_set.images[0].parent, len(image_set.images)
    share = LEAST_COMMON_SHARE if structure.leave_out and not image_set.film else structure.min_share
    needed = max(structure.min_images, math.ceil(share * count))
    rich = count_rich(gather_tracks(database, image_set.names), options)
    total, stayed = leave_out_contradicted(database, scene)
    figures["guided"] = {"matches": total, "stayed": stayed}
    if rich >= needed and stayed < LEAST_STAYED * total:
        raise RegistrationFailed(
            f"the network's cameras contradict {1 - stayed / total:.0%} of the matches, which connect {rich} of {count} images: it is"
            " wrong about these pictures; use the registration colmap",
            {},
        )
    adjusted = adjust_cameras(scene.cameras, gather_tracks(database, image_set.names), LENS, options.max_error_px)
    adjusted = drop_weak_images(adjusted, options.min_observations, options.max_error_px)
    held = adjusted.num_reg_images()
    if held >= MIN_VIEWS and adjusted.num_points3D():
        model = triangulate(adjusted, database, folder, structure.seed)
        if held < count:
            model = register_again(model, [], database, folder, database.parent, structure.seed)
        held = model.num_reg_images()
    if held < needed:
        raise TooFewMatches(f"matches hold {held} of {count} images, at least {needed} are needed")
    return model


def count_rich(tracks: TrackObservations, options: Da3Options) -> int:
    """How many images see enough tracks."""
    return int((tracks.seen.sum(1) >= options.min_observations).sum())


def gather_tracks(database: Path, names: list[str]) -> TrackObservations:
    """What verified matches connect in at least three images; where they connect two places of one image, that image does not see it."""
    with pycolmap.Database.open(database) as opened:
        number = {opened.read_image_with_name(name).image_id: index for index, name in enumerate(names)}
        keypoints = [opened.read_keypoints(image_id)[:, :2].astype(np.float64).reshape(-1, 2) for image_id in number]
        matches = {}
        for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = (number[image_id] for image_id in pycolmap.pair_id_to_image_pair(pair_id))
            if len(geometry.inlier_matches):
                matches[first, second] = (geometry.inlier_matches[:, 0], geometry.inlier_matches[:, 1])
    counts = [len(points) for points in keypoints]
    track, view = label_tracks(counts, matches), np.repeat(np.arange(len(names)), counts)
    places, which, times = np.unique(track.astype(np.int64) * len(names) + view, return_inverse=True, return_counts=True)
    once = np.flatnonzero(times[which] == 1)
    views = np.bincount(places[times == 1] // len(names), minlength=1)
    long = np.flatnonzero(views >= MIN_VIEWS)
    long = long[np.unique(np.linspace(0, max(len(long) - 1, 0), min(MAX_TRACKS, len(long))).astype(int))]
    column = np.full(len(views), -1)
    column[long] = np.arange(len(long))
    seen = np.zeros((len(names), len(long)), bool)
    xy = np.zeros((*seen.shape, 2))
    once = once[column[track[once]] >= 0]
    at = view[once], column[track[once]]
    seen[at], xy[at] = True, np.concatenate(keypoints)[once]
    return TrackObservations(xy, seen, np.zeros((len(long), 3), np.uint8))


def triangulate(adjusted: pycolmap.Reconstruction, database: Path, images: Path, seed: int) -> pycolmap.Reconstruction:
    """The poses and the lens of a model, with points from all matches of a database; the lens is refined with them."""
    lens = adjusted.cameras[1]
    poses = {image.name: image.cam_from_world() for image in adjusted.images.values() if image.has_pose}
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        for camera in opened.read_all_cameras():
            camera.params = lens.params
            model.add_camera_with_trivial_rig(camera)
        for image in opened.read_all_images():
            if image.name in poses:
                keypoints = opened.read_keypoints(image.image_id)[:, :2].astype(np.float64)
                copy = pycolmap.Image(name=image.name, keypoints=keypoints, camera_id=image.camera_id, image_id=image.image_id)
                model.add_image_with_trivial_frame(copy, poses[image.name])
    found = database.parent / "triangulated"
    found.mkdir(exist_ok=True)
    return pycolmap.triangulate_points(model, database, images, found, options=make_mapping_options(MIN_VIEWS, seed))
