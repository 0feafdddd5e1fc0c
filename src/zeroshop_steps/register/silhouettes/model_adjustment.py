"""Adjust a COLMAP model of an object by the outlines that its masks show."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera, to_rigid
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.undistortion import undistort_masks
from zeroshop_steps.register.silhouettes.bundle_adjustment import SilhouetteAdjustment
from zeroshop_steps.register.silhouettes.state import TrackKind, Tracks


@dataclass(frozen=True)
class AdjustedModel:
    """A model that was adjusted by outlines.

    Attributes:
        model: an adjusted copy.
        cameras: its pinhole cameras, in the order in which they were given.
        missed_px: by how much the rays of the rims missed the other masks before and after, px per 1000 px of the image, in the mean, to
            three digits.
        error_px: the reprojection error of the tracks before and after, the same.
        standing_out: names of the images whose masks, or cameras, contradict the others'.
    """

    model: pycolmap.Reconstruction
    cameras: list[Camera]
    missed_px: tuple[float, float]
    error_px: tuple[float, float]
    standing_out: list[str]


def adjust_model_by_silhouettes(
    model: pycolmap.Reconstruction, image_set: ImageSet, wrong_masks: Collection[str] = (), kind: TrackKind = TrackKind.MATCHED
) -> AdjustedModel:
    """Adjust poses, focal lengths (by one factor) and points by the tracks and the masks' rims, but for those of wrong masks.

    Args:
        kind: of the tracks.
    """
    cameras, masks = undistort_masks(model, image_set)
    right = {name: mask for name, mask in masks.items() if name not in wrong_masks}
    return adjust_model_by_masks(model, cameras, right, kind, image_set.masks_found)


def adjust_model_by_masks(
    model: pycolmap.Reconstruction,
    cameras: list[Camera],
    masks: dict[str, np.ndarray],
    kind: TrackKind = TrackKind.MATCHED,
    found: bool = False,
) -> AdjustedModel:
    """Adjust poses, focal lengths (by one factor) and points by the tracks and the masks' rims.

    Args:
        model: whose images with a pose are adjusted.
        cameras: their pinhole cameras.
        masks: {image name: (height, width) bool}, of the pinhole cameras' sizes; other images are held by their tracks alone.
        kind: of the tracks.
        found: whether the masks were found in each photo.
    """
    point_ids, tracks = read_tracks(model, cameras)
    adjustment = SilhouetteAdjustment(cameras, masks, tracks)
    before_px, error_before_px = adjustment.measure_misses_px(), adjustment.measure_error_px()
    adjustment.adjust(kind, found)
    after_px, error_after_px = adjustment.measure_misses_px(), adjustment.measure_error_px()
    copy = pycolmap.Reconstruction(model)
    for lens in copy.cameras.values():
        params = lens.params.copy()
        params[list(lens.focal_length_idxs())] *= np.exp(adjustment.state.log_focal)
        lens.params = params
    placed = {image.name: image for image in copy.images.values() if image.has_pose}
    adjusted = adjustment.adjusted_cameras()
    for camera in adjusted:
        image = placed[camera.name]
        copy.frames[image.frame_id].set_cam_from_world(image.camera_id, to_rigid(camera.camera_from_world))
    for point_id, place in zip(point_ids, adjustment.adjusted_points(), strict=True):
        copy.points3D[point_id].xyz = place
    # A point that few rays hold may have come to lie behind a camera, where it has no error.
    pycolmap.ObservationManager(copy).filter_observations_with_negative_depth()
    copy.update_point_3d_errors()
    standing_out = [cameras[number].name for number in adjustment.find_standing_out(after_px)]
    missed_px = round(float(before_px.mean()), 3), round(float(after_px.mean()), 3)
    return AdjustedModel(copy, adjusted, missed_px, (error_before_px, error_after_px), standing_out)


def read_tracks(model: pycolmap.Reconstruction, cameras: list[Camera]) -> tuple[list[int], Tracks]:
    """The ids of a model's points, and their observations in pixels of its pinhole cameras."""
    number = {camera.name: index for index, camera in enumerate(cameras)}
    pixels = {}
    for image in model.images.values():
        if image.has_pose:
            intrinsics = cameras[number[image.name]].intrinsics
            seen = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
            pixels[image.image_id] = model.cameras[image.camera_id].cam_from_img(seen) * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]
    ids = sorted(model.point3D_ids())
    view, point, places = [], [], []
    for index, point_id in enumerate(ids):
        for element in model.points3D[point_id].track.elements:
            view.append(number[model.images[element.image_id].name])
            point.append(index)
            places.append(pixels[element.image_id][element.point2D_idx])
    return ids, Tracks(np.array(view, int), np.array(point, int), np.array(places).reshape(-1, 2))


def replace_tracks(model: pycolmap.Reconstruction, cameras: list[Camera], tracks: Tracks) -> pycolmap.Reconstruction:
    """The images and cameras of a model without distortion, with the points of other tracks; where these lie is left to an adjustment.

    Args:
        model: whose images with a pose are taken.
        cameras: their pinhole cameras, in whose pixels the tracks are.
    """
    copy = pycolmap.Reconstruction()
    for camera in model.cameras.values():
        copy.add_camera_with_trivial_rig(camera)
    placed = {image.name: image for image in model.images.values() if image.has_pose}
    ids, place = [placed[camera.name].image_id for camera in cameras], np.zeros(len(tracks.view), int)
    for number, camera in enumerate(cameras):
        image, seen = placed[camera.name], tracks.view == number
        place[seen] = np.arange(seen.sum())
        taken = pycolmap.Image(name=image.name, keypoints=tracks.pixels[seen], camera_id=image.camera_id, image_id=image.image_id)
        copy.add_image_with_trivial_frame(taken, image.cam_from_world())
    for point in range(tracks.count):
        track = pycolmap.Track()
        for observation in np.flatnonzero(tracks.point == point):
            track.add_element(ids[tracks.view[observation]], int(place[observation]))
        copy.add_point3D(np.zeros(3), track)
    return copy
