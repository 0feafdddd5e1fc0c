"""Do points that two neighbouring images should both show, and that were not matched, look alike where they should lie?

That two images share few points may have two reasons. Sides that look alike were laid onto each other: then the images show different
things. Or features were missed, as in blurred frames, near a floor, or where glass mirrors: then the images show the same. So the patch
around each unmatched point is carried into the other image, and compared there by normalized cross-correlation, in its place and at the
places of other points of that image. In its place it must fit better than elsewhere. How well is no matter: blur and light differ. It is
carried as a plane that faces both cameras and as one that its neighbouring points span, such as a table's, and counts by the better one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras.pinhole import Camera, take_cameras
from zeroshop_steps.geometry.imaging.image_overlap import SIDE_PX
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.register.photometry.score import LEAST_CONTRAST, correlate
from zeroshop_steps.register.photometry.transfer import carry_by_plane
from zeroshop_steps.register.verification.covisibility import find_neighbours

# Set on whole scenes of photos and film frames, right ones and wrong ones.
PATCH_PX, PLAY_PX = 15, 5  # what is compared, and how far it may lie beside its place
MOST_ANGLE_DEG, MOST_SCALE = 20.0, 1.4
"""Between the rays to a point, and between its distances: farther apart, even a plane looks different."""
MOST_POINTS, LEAST_POINTS = 40, 10  # of a pair, in either direction: that are compared, and that tell something
OTHER_PLACES, LEAST_PLACES = 10, 3
AWAY_PX = PATCH_PX * 3  # other places are so far from the point's own
PLANE_POINTS = 12  # nearest points, which span the plane around a point
LEAST_SLOPE = 0.1  # cosine between a plane's normal and the ray to a camera; flatter planes are seen too obliquely to be carried
MOST_PAIRS = 150  # that are compared, drawn at random
LIKE_SHARE = 0.7
"""Two images are unlike where their patches fit fewer of the other places worse than their own: by chance it is a half."""

Places = dict[int, tuple[np.ndarray, np.ndarray]]
"""Position and normal, (3,) each, of the points by their ids."""


@dataclass(frozen=True)
class _Image:
    """A small copy of an image: its camera, (H, W) float32 grey, and the ids of the points that it sees."""

    camera: Camera
    grey: np.ndarray
    seen: np.ndarray


def find_mismatched_pairs(model: pycolmap.Reconstruction, folder: Path) -> tuple[int, list[tuple[str, str]]]:
    """How many pairs of neighbouring images could be compared, and the stems of those that do not show the same.

    Args:
        model: pinhole cameras; its images are named STEM.png.
        folder: of the undistorted images.
    """
    names, near = find_neighbours(model)
    rng = np.random.default_rng(0)  # draws pairs and points
    pairs = np.argwhere(np.triu(near, 1))
    pairs = pairs[np.sort(rng.permutation(len(pairs))[:MOST_PAIRS])]
    cameras = {camera.name: camera for camera in take_cameras(model)}
    seen = {image.name: np.array(sorted({p.point3D_id for p in image.points2D if p.has_point3D()}), int) for image in model.images.values()}
    small = {index: _shrink(cameras[names[index]], folder, seen[names[index]]) for index in np.unique(pairs).tolist()}
    places = {point_id: (point.xyz, normal) for (point_id, point), normal in zip(model.points3D.items(), _span_planes(model), strict=True)}
    judged, unlike = 0, []
    for one, other in pairs.tolist():
        won = [*_compare(small[one], small[other], places, rng), *_compare(small[other], small[one], places, rng)]
        if len(won) < LEAST_POINTS:
            continue
        judged += 1
        if np.mean(won) < LIKE_SHARE:
            unlike.append((Path(names[one]).stem, Path(names[other]).stem))
    return judged, unlike


def _shrink(camera: Camera, folder: Path, seen: np.ndarray) -> _Image:
    scale = min(1.0, SIDE_PX / max(camera.width_px, camera.height_px))
    camera = camera.resized(round(camera.width_px * scale), round(camera.height_px * scale))
    grey = cv2.cvtColor(read_image(folder / camera.name), cv2.COLOR_RGB2GRAY)
    return _Image(camera, cv2.resize(grey, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA).astype(np.float32), seen)


def _span_planes(model: pycolmap.Reconstruction) -> np.ndarray:
    """(P, 3) unit normals of the planes that the nearest points of each point span."""
    points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
    if len(points) < PLANE_POINTS:
        return np.zeros_like(points)
    near = points[cKDTree(points).query(points, PLANE_POINTS)[1]]
    away = near - near.mean(1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("pki,pkj->pij", away, away))[1][:, :, 0])


def _compare(one: _Image, other: _Image, places: Places, rng: np.random.Generator) -> list[float]:
    """For unmatched points of one image, the share of other places in the other image that their patches fit worse than their own."""
    unmatched = one.seen[~np.isin(one.seen, other.seen)]
    if not len(unmatched) or not len(other.seen):
        return []
    points, normals = (np.array(part) for part in zip(*(places[index] for index in unmatched.tolist()), strict=True))
    chosen = np.flatnonzero(other.camera.find_pixels(points)[3] & _look_alike(points, one.camera, other.camera))
    chosen = chosen[rng.permutation(len(chosen))[:MOST_POINTS]]
    elsewhere = other.camera.project(np.array([places[index][0] for index in other.seen.tolist()]))[0]
    shares = []
    for point, normal in zip(points[chosen], normals[chosen], strict=True):
        planes = _find_planes(point, normal, one.camera, other.camera)
        carried = (carry_by_plane(point, plane, one.grey, one.camera, other.camera, PATCH_PX // 2) for plane in planes)
        patches = [patch for patch in carried if patch.std() >= LEAST_CONTRAST]
        own = other.camera.project(point[None])[0][0]
        score = _match(patches, other.grey, own)
        if score is None:
            continue
        away = elsewhere[np.linalg.norm(elsewhere - own, axis=1) > AWAY_PX]
        scores = [_match(patches, other.grey, place) for place in away[rng.permutation(len(away))[:OTHER_PLACES]]]
        found = [value for value in scores if value is not None]
        if len(found) >= LEAST_PLACES:
            shares.append(float(np.mean([value < score for value in found])))
    return shares


def _look_alike(points: np.ndarray, one: Camera, other: Camera) -> np.ndarray:
    """(P,) bool: which of (P, 3) points two cameras see from about the same direction and distance."""
    rays = [points - camera.centre_in_world for camera in (one, other)]
    first, second = (np.linalg.norm(ray, axis=1) for ray in rays)
    cosine = np.einsum("ij,ij->i", *rays) / np.maximum(first * second, 1e-12)
    alike: np.ndarray = (cosine > np.cos(np.radians(MOST_ANGLE_DEG))) & (np.abs(np.log(first / second)) < np.log(MOST_SCALE))
    return alike


def _find_planes(point: np.ndarray, normal: np.ndarray, one: Camera, other: Camera) -> list[np.ndarray]:
    """Normals of the planes by which a point's patch is carried: one that faces both cameras and, unless it is too oblique, its own."""
    looks = [point - camera.centre_in_world for camera in (one, other)]
    looks = [look / np.linalg.norm(look) for look in looks]
    own = [normal] if min(abs(float(look @ normal)) for look in looks) >= LEAST_SLOPE else []
    return [looks[0] + looks[1], *own]


def _match(patches: Sequence[np.ndarray], grey: np.ndarray, place: np.ndarray) -> float | None:
    """The best normalized cross-correlation of one of the patches near a place, (x, y); None without any, or where the image ends there."""
    column, row = np.floor(place).astype(int)
    reach = PATCH_PX // 2 + PLAY_PX
    if not patches or min(column, row) < reach or column + reach >= grey.shape[1] or row + reach >= grey.shape[0]:
        return None
    window = grey[row - reach : row + reach + 1, column - reach : column + reach + 1]
    return max(float(correlate(window, patch).max()) for patch in patches)
