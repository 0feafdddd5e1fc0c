"""Match the pictures of an object whose cameras are nearly known: each corner is looked for where the visual hull says that it is.

Where an object has little print, features that are found in each image by itself are few, and hardly match between views 36 degrees apart.
With cameras that outlines placed a few pixels off, the patch around a corner is carried into the other views along the hull's surface, and
found near its place there. Even a banana's spots, or the grain of a black clamp, then give hundreds of matches to a few tenths of a pixel.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.geometry.observation.visual_hull import VisualHull, find_inside_masks
from zeroshop_steps.register.mapping.reregistration import MIN_ANGLE_DEG
from zeroshop_steps.register.matching.verified_matches import MAX_ERROR_PX
from zeroshop_steps.register.photometry.hull_views import MISSING_SHARE
from zeroshop_steps.register.photometry.score import correlate, find_peak
from zeroshop_steps.register.photometry.transfer import cut_patch, span_axes
from zeroshop_steps.register.refinement.keypoint_refinement import LEAST_ALIGNED
from zeroshop_steps.register.scene.image_set import REFERENCE_PX, ImageSet
from zeroshop_steps.register.scene.undistortion import undistort_masks
from zeroshop_steps.register.silhouettes.coherence import bound_object, shrink_masks
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_masks, replace_tracks
from zeroshop_steps.register.silhouettes.state import TrackKind, Tracks

ROUNDS_PX = (12, 7)  # of each round: how far from where the cameras say a corner is looked for, per 1000 px of the image

HALF_PX = 5  # half of a patch's side, of images of `REFERENCE_PX`: larger ones lie on a curved surface, and give fewer and worse matches
CORNERS, APART_PX, LEAST_QUALITY = 800, 4, 0.002  # of each view, at most; between them; of their contrast, by the strongest one's
RIM_PX = 2  # by which a patch may reach over the mask's rim, so that thin things have some
BLOCK_PX = 7  # side of the window in which a corner's contrast is measured
LEAST_CONTRAST = 3.0  # standard deviation of a patch's grey, of 255
LARGEST_DEG, LEAST_COSINE = 60.0, 0.3  # between two views' directions; between the surface's normal and those to both cameras
VOXELS, DEPTHS = 128, 256  # along each edge of the hull, for its normals; along each ray, to its surface


@dataclass(frozen=True)
class _SmallView:
    """A view of at most `REFERENCE_PX`, in a world whose origin is the object's centre; its mask is bool, and its grey float32."""

    camera: Camera
    mask: np.ndarray
    grey: np.ndarray

    def find_corners(self) -> np.ndarray:
        """(K, 2) pixels of corners whose patches lie in the mask, but for a rim."""
        whole = cv2.erode(self.mask.astype(np.uint8), np.ones((2 * (HALF_PX - RIM_PX) + 1,) * 2))
        found = cv2.goodFeaturesToTrack(self.grey, CORNERS, LEAST_QUALITY, APART_PX, mask=whole, blockSize=BLOCK_PX)
        return np.zeros((0, 2)) if found is None else found[:, 0].astype(float) + 0.5


@dataclass(frozen=True)
class _Hull:
    """The visual hull of small views: its radius, the views whose masks may lack a part, and its outermost voxels and their normals."""

    views: Sequence[_SmallView]
    radius: float
    allowed: int
    nearest: cKDTree
    normals: np.ndarray

    @staticmethod
    def carve(views: Sequence[_SmallView], radius: float) -> "_Hull":
        allowed = max(1, round(MISSING_SHARE * len(views)))
        cameras, masks = [view.camera for view in views], [view.mask for view in views]
        points, normals = VisualHull.carve(cameras, masks, radius, VOXELS, allowed).surface()
        return _Hull(views, radius, allowed, cKDTree(points), normals)

    def enter(self, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P,) numbers of the rays through (K, 2) pixels that meet the hull, and (P, 3) where these do."""
        middle = camera.camera_from_world[2, 3]
        depths = np.linspace(middle - self.radius, middle + self.radius, DEPTHS)
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.intrinsics).T
        along = (rays[:, None] * depths[:, None] - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]
        cameras, masks = [view.camera for view in self.views], [view.mask for view in self.views]
        inside = find_inside_masks(along.reshape(-1, 3), cameras, masks, self.allowed).reshape(along.shape[:2])
        met = np.flatnonzero(inside.any(1))
        return met, along[met, inside[met].argmax(1)]


@dataclass(frozen=True)
class _Corners:
    """Corners of a view on the hull, K of them.

    Attributes:
        pixels: (K, 2) in the view.
        points, normals: (K, 3) on the hull, and its unit normals.
        spans: (K, 3, 3) the points, and those half a patch to the right of them and below, in the hull's surface.
        patches: what the view shows there.
    """

    pixels: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    spans: np.ndarray
    patches: Sequence[np.ndarray]

    @staticmethod
    def find(view: _SmallView, hull: _Hull) -> "_Corners":
        """Those whose patches have contrast, and at which the hull faces the view."""
        pixels = view.find_corners()
        met, points = hull.enter(view.camera, pixels)
        normals = hull.normals[hull.nearest.query(points)[1]].reshape(-1, 3)
        facing = _face(points, normals, view.camera)
        pixels, points, normals = pixels[met][facing], points[facing], normals[facing]
        size = HALF_PX * view.camera.project(points)[1] / view.camera.intrinsics[0, 0]
        ends = size[:, None, None] * span_axes(normals, view.camera.camera_from_world[0, :3])
        spans = points[:, None] + np.concatenate([np.zeros((len(points), 1, 3)), ends], axis=1)
        axes = _find_axes(view.camera, spans)[1]
        patches = [cut_patch(view.grey, shape, middle, HALF_PX) for shape, middle in zip(axes, pixels, strict=True)]
        kept = np.flatnonzero([patch.std() >= LEAST_CONTRAST for patch in patches])
        return _Corners(pixels[kept], points[kept], normals[kept], spans[kept], [patches[number] for number in kept])

    def find_in(self, view: _SmallView, play_px: int) -> Iterator[tuple[int, np.ndarray]]:
        """The numbers of those that another view shows, and the (2,) pixels there."""
        middles, axes = _find_axes(view.camera, self.spans)
        framed = view.camera.find_pixels(self.points)[3]
        for number in np.flatnonzero(framed & _face(self.points, self.normals, view.camera)).tolist():
            around = cut_patch(view.grey, axes[number], middles[number], HALF_PX + play_px)
            peak = find_peak(correlate(around, self.patches[number]))
            if peak is not None:
                yield number, middles[number] + axes[number] @ (peak - play_px)


def match_along_hull(cameras: Sequence[Camera], masks: dict[str, np.ndarray], images: Sequence[np.ndarray], play_px: int) -> Tracks:
    """Tracks of the corners of each view, with the places at which the other views show them.

    Args:
        cameras: N pinhole cameras, a few pixels off.
        masks: {image name: (height, width) bool}, of the cameras' sizes.
        images: (height, width) uint8 grey, in the order of the cameras.
        play_px: how far from where the cameras say a corner may lie, of images of `REFERENCE_PX`.

    Returns:
        In pixels of the given cameras. A corner that no other view shows has no track.
    """
    centre, radius = bound_object(list(cameras), [masks[camera.name] for camera in cameras])
    to_centre = make_transform(np.eye(3), -centre)
    small, small_masks = shrink_masks([transform_camera(camera, to_centre) for camera in cameras], masks)
    views = [_SmallView(camera, small_masks[camera.name], _resize(image, camera)) for camera, image in zip(small, images, strict=True)]
    hull = _Hull.carve(views, radius)
    directions = np.array([view.camera.centre_in_world / np.linalg.norm(view.camera.centre_in_world) for view in views])
    view_numbers, point_numbers, pixels, count = list[int](), list[int](), list[np.ndarray](), 0
    for one, view in enumerate(views):
        corners = _Corners.find(view, hull)
        places = [{one: pixel} for pixel in corners.pixels]
        for other in np.flatnonzero(directions @ directions[one] > np.cos(np.radians(LARGEST_DEG))).tolist():
            if other != one:
                for corner, place in corners.find_in(views[other], play_px):
                    places[corner][other] = place
        for found in places:
            if len(found) > 1:
                view_numbers += found.keys()
                point_numbers += [count] * len(found)
                pixels += [place * cameras[number].width_px / views[number].camera.width_px for number, place in found.items()]
                count += 1
    return Tracks(np.array(view_numbers, int), np.array(point_numbers, int), np.array(pixels).reshape(-1, 2))


def _resize(image: np.ndarray, camera: Camera) -> np.ndarray:
    """An image as float32, of a camera's size."""
    return cv2.resize(image, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA).astype(np.float32)


def _face(points: np.ndarray, normals: np.ndarray, camera: Camera) -> np.ndarray:
    """(P,) bool: at which of (P, 3) points with unit normals a surface faces a camera."""
    looks = camera.centre_in_world - points
    facing: np.ndarray = (looks * normals).sum(1) > LEAST_COSINE * np.linalg.norm(looks, axis=1)
    return facing


def _find_axes(camera: Camera, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) pixels of the middles of patches that (K, 3, 3) points span, and (K, 2, 2) their axes in the image."""
    pixels = camera.project(spans.reshape(-1, 3))[0].reshape(-1, 3, 2)
    return pixels[:, 0], ((pixels[:, 1:] - pixels[:, :1]) / HALF_PX).transpose(0, 2, 1)


def adjust_by_guided_tracks(model: pycolmap.Reconstruction, image_set: ImageSet) -> tuple[pycolmap.Reconstruction, dict[str, Any]]:
    """A copy of a model of pinhole cameras, adjusted by corners that are found along the hull and by outlines; its points are the corners.

    Returns:
        The copy, and figures: the numbers of `tracks` and of their `observations`; `miss_px` and `error_px`, by how much rims and tracks
        missed in the mean before and after the last round, px per 1000 px of the image. Where fewer than `LEAST_ALIGNED` corners are found,
        the model as it was.
    """
    greys = {path.name: cv2.cvtColor(read_image(path), cv2.COLOR_RGB2GRAY) for path in image_set.images}
    figures: dict[str, Any] = {}
    for play_px in ROUNDS_PX:
        cameras, masks = undistort_masks(model, image_set)
        tracks = match_along_hull(cameras, masks, [greys[camera.name] for camera in cameras], play_px)
        figures |= {"tracks": tracks.count, "observations": len(tracks.view)}
        if tracks.count < LEAST_ALIGNED:
            break
        adjusted = adjust_model_by_masks(replace_tracks(model, cameras, tracks), cameras, masks, TrackKind.GUIDED, image_set.masks_found)
        model = adjusted.model
        figures |= {"miss_px": list(adjusted.missed_px), "error_px": [round(error_px, 3) for error_px in adjusted.error_px]}
    if "miss_px" not in figures:
        return model, figures
    largest_px = max(max(camera.width, camera.height) for camera in model.cameras.values())
    pycolmap.ObservationManager(model).filter_all_points3D(MAX_ERROR_PX * largest_px / REFERENCE_PX, MIN_ANGLE_DEG)
    model.update_point_3d_errors()
    model.extract_colors_for_all_images(image_set.images[0].parent, 1)
    return model, figures
