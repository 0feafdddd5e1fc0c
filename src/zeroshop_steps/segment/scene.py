"""What masks are found from: photos of one size and exposure, their cameras, and what a network saw in them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, SparseModel
from zeroshop_steps.geometry.cameras.ray_convergence import find_nearest_point
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.support.scene_support import SceneSupport, find_scene_focus, fit_level_planes
from zeroshop_steps.networks.saliency.object_finder import keep_main_thing
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.segment.ground_picture import GroundPicture, build_ground_picture
from zeroshop_steps.segment.outlines.prompts import PromptedSegmenter
from zeroshop_steps.segment.outlines.windows import Window, cut_part, resample_map, take_whole
from zeroshop_steps.segment.photometry.exposure import Exposure, apply_gain

KEPT_WIDTH_PX = 1600  # of photos in memory: windows of them are looked at closer, and 60 large photos would not fit
SHARED = 0.5  # of the other views that show the object at a pixel, for it to be there
LEAST_RAYS = 3  # photos in which a network sees something, to tell where that is


@dataclass(frozen=True)
class MaskScene:
    """Windows of registered photos.

    Attributes:
        views: the registered views.
        model: their sparse points.
        photos: (H, W, 3) uint8 RGB of each view, of equal exposure, at most `KEPT_WIDTH_PX` wide.
        windows: the parts of the photos that are looked at, in pixels of the views.
        cameras: of these windows, at the width at which masks are cut.
        saliency: (h, w) float32, 0 to 1, what a salient-object network sees in each whole photo, of the cameras' sizes; None without one.
        closer_saliency: what it sees in each window alone; None where it was not asked.
        width_px: the width at which masks are cut.
        segmenter: Segment Anything, asked where a hull is known; None without it.
        planes: level planes that many sparse points lie on, falling (fit_level_planes).
    """

    views: Sequence[View]
    model: SparseModel
    photos: Sequence[np.ndarray]
    windows: Sequence[Window]
    cameras: Sequence[Camera]
    saliency: Sequence[np.ndarray] | None
    closer_saliency: Sequence[np.ndarray] | None
    width_px: int
    segmenter: PromptedSegmenter | None
    planes: Sequence[SceneSupport]

    @cached_property
    def images(self) -> list[np.ndarray]:
        """(h, w, 3) float32 RGB, 0 to 255, of the cameras' sizes."""
        return map_in_threads(self._resample, self.photos, self.views, self.windows, self.cameras)

    @staticmethod
    def _resample(photo: np.ndarray, view: View, window: Window, camera: Camera) -> np.ndarray:
        part = cut_part(photo, view, window)
        enlarged = camera.width_px > part.shape[1]
        size_px = (camera.width_px, camera.height_px)
        return cv2.resize(part, size_px, interpolation=cv2.INTER_LINEAR if enlarged else cv2.INTER_AREA).astype(np.float32)

    @cached_property
    def focus(self) -> tuple[np.ndarray, float]:
        """(3,) the point that the cameras look at, where a network sees something in them, and their median distance from it."""
        focus, distance = find_scene_focus(self.model)
        if self.saliency is None:
            return focus, distance
        centres, rays = [], []
        for camera, seen in zip(self.cameras, self.saliency, strict=True):
            rows, columns = np.nonzero(keep_main_thing(seen) > 0.5)
            if len(rows):
                centres.append(camera.centre_in_world)
                rays.append(camera.find_ray(columns.mean() + 0.5, rows.mean() + 0.5))
        if len(rays) < LEAST_RAYS:
            return focus, distance
        point = find_nearest_point(np.array(centres), np.array(rays))
        ways = point - np.array(centres)
        if np.median((ways * np.array(rays)).sum(1)) <= 0:
            return focus, distance
        return point, float(np.median(np.linalg.norm(ways, axis=1)))

    def place(self, support: SceneSupport | None) -> SceneSupport | None:
        """A plane with the scene's focus and distance."""
        focus, distance = self.focus
        return None if support is None else replace(support, focus=focus, distance=distance)

    def take(self, part: slice) -> "MaskScene":
        """Some of the views."""
        saliency = None if self.saliency is None else self.saliency[part]
        model = replace(self.model, seen=None if self.model.seen is None else self.model.seen[part])
        own = self.views[part], model, self.photos[part], self.windows[part], self.cameras[part], saliency, None
        return MaskScene(*own, self.width_px, None, self.planes)

    def look_closer(self, windows: Sequence[Window], network: SalientObjectNetwork | None) -> "MaskScene":
        """The scene seen through other windows.

        The network sees each of them alone: it reduces what it sees to a small square, so the outline of a small thing is coarse in a
        whole photo. But from closer a part may look like a thing: both looks are cues.
        """
        cameras = [_cut_camera(view, window, self.width_px) for view, window in zip(self.views, windows, strict=True)]
        saliency = None
        if self.saliency is not None:
            before = zip(self.saliency, self.windows, windows, self.views, cameras, strict=True)
            saliency = [resample_map(*parts) for parts in before]
        closer = None
        if network is not None:
            parts = [cut_part(*one) for one in zip(self.photos, self.views, windows, strict=True)]
            closer = network.predict_all(parts, [(camera.width_px, camera.height_px) for camera in cameras])
        return replace(self, windows=windows, cameras=cameras, saliency=saliency, closer_saliency=closer)


def read_mask_scene(
    views: Sequence[View],
    model: SparseModel,
    exposure: Exposure,
    saliency: Sequence[np.ndarray] | None,
    width_px: int,
    segmenter: PromptedSegmenter | None = None,
    seed: int = 0,
) -> MaskScene:
    """Read the whole photos.

    Args:
        views, model: the registered views and their sparse points.
        exposure: the factors that make them equal.
        saliency: (h, w) of each photo, 0 to 1, of any size; None without a network.
        width_px: the width at which masks are cut.
        segmenter: Segment Anything; None without it.
        seed: of the RANSAC that fits planes.
    """

    def read(view: View, log_gain: np.ndarray) -> np.ndarray:
        photo = view.image()
        height, width = photo.shape[:2]
        if width > KEPT_WIDTH_PX:
            photo = cv2.resize(photo, (KEPT_WIDTH_PX, round(height * KEPT_WIDTH_PX / width)), interpolation=cv2.INTER_AREA)
        return apply_gain(photo, np.exp(log_gain)) if exposure.corrected else photo

    windows = take_whole(views)
    cameras = [_cut_camera(view, window, width_px) for view, window in zip(views, windows, strict=True)]
    photos = map_in_threads(read, views, exposure.log_gains)
    if saliency is not None:
        saliency = [
            cv2.resize(seen, (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR)
            for seen, camera in zip(saliency, cameras, strict=True)
        ]
    return MaskScene(
        views, model, photos, windows, cameras, saliency, None, width_px, segmenter, fit_level_planes(model, list(views), seed)
    )


@dataclass(frozen=True)
class Hull:
    """What the views share.

    Attributes:
        occupied: (X, Y, Z) bool: the voxels of the object.
        silhouettes: (h, w) bool: of these voxels, in every view.
        shares: (h, w) float32 of 0 to 1: the share of the other views that show the object there (voxels.render_shares).
        others: (h, w) bool: silhouettes of other things.
    """

    occupied: np.ndarray
    silhouettes: Sequence[np.ndarray]
    shares: Sequence[np.ndarray]
    others: Sequence[np.ndarray]

    def find_shared(self, index: int) -> np.ndarray:
        """(h, w) bool: where the other views show the object in this one, most of them."""
        return np.asarray(self.shares[index] >= SHARED)


@dataclass(frozen=True)
class Guess:
    """What is known of the object before it is cut out.

    Attributes:
        support: the plane that it stands on; None where there is none.
        ground: the picture of that plane; None likewise.
        hull: of the object; None where it is not known yet.
    """

    support: SceneSupport | None
    ground: GroundPicture | None = None
    hull: Hull | None = None


def start_guess(scene: MaskScene, support: SceneSupport | None) -> Guess:
    """Nothing is known but the plane."""
    return Guess(support, None if support is None else build_ground_picture(support, scene.cameras, scene.images))


def _cut_camera(view: View, window: Window, width_px: int) -> Camera:
    """The camera of a window at most `width_px` wide; one higher than wide has as many pixels as a square."""
    width, height = window.right - window.left, window.bottom - window.top
    part = view.camera.cropped(window.left, window.top, width, height)
    size = min(round(width_px * min(1.0, math.sqrt(width / height))), width)
    return part.resized(size, max(round(height * size / width), 1))
