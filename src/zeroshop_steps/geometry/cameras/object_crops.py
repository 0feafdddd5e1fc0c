"""The part of each registered image that shows the object: the sphere around the object, and the crop around its mask."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.errors import StepError

STRIDE_PX = 3
"""Stereo estimates planes at every third pixel of every third row; patches are compared at the images' own resolution."""
SEED_WIDTH_PX = 1000
"""Largest width of the images in which stereo looks for seeds: the inner walls of some objects have fine print only."""
USUAL_SHARES, COARSEST = (0.55, 0.8), 0.6
"""Of the image's width, the diameter of the sphere around the object for which widths are meant; rendered captures have 0.61 to 0.67. Of
smaller objects, images are taken as much finer; of larger ones, which would only take longer, coarser, down to this factor."""
SEED_BORDER_PX = 10  # around the mask, so that patches at its rim lie in the crop


@dataclass(frozen=True)
class ObjectSphere:
    """A sphere around the object: world = centre + radius * normalized. Surfaces are optimized in normalized coordinates."""

    centre: np.ndarray
    radius: float

    def normalized(self, camera: Camera) -> Camera:
        """The camera in normalized coordinates."""
        camera_from_world = camera.camera_from_world.copy()
        camera_from_world[:3, 3] = (camera_from_world[:3, :3] @ self.centre + camera_from_world[:3, 3]) / self.radius
        return Camera(camera.name, camera.width_px, camera.height_px, camera.intrinsics, camera_from_world)


def fit_object_sphere(cameras: Sequence[Camera], masks: Sequence[np.ndarray]) -> ObjectSphere:
    """The sphere around the object that the masks show.

    Its centre is nearest, in the least-squares sense, to the rays through the centres of the masks' boxes. Its radius holds the
    largest half diagonal of a box, back-projected to the centre's depth. Cameras and masks must be right: unlike
    `rays.find_nearest_point`, which checks of cameras use, wrong ones move this centre.

    Raises:
        StepError: the centre lies behind a camera.
    """
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    half_diagonals = []
    for camera, mask in zip(cameras, masks, strict=True):
        ys, xs = np.nonzero(mask)
        middle = np.array([(xs.min() + xs.max() + 1) / 2, (ys.min() + ys.max() + 1) / 2, 1.0])
        half_diagonals.append(np.hypot(np.ptp(xs) + 1, np.ptp(ys) + 1) / 2)
        ray = camera.camera_from_world[:3, :3].T @ np.linalg.solve(camera.intrinsics, middle)
        ray /= np.linalg.norm(ray)
        across = np.eye(3) - np.outer(ray, ray)
        matrix += across
        vector += across @ camera.centre_in_world
    centre = np.linalg.solve(matrix, vector)
    depths = [camera.project(centre[None])[1][0] for camera in cameras]
    if min(depths) <= 0:
        name = cameras[int(np.argmin(depths))].name
        raise StepError(f"the masked object lies behind the camera of {name}: that camera is wrong; leave the photo out or take it again")
    radius = max(half * depth / camera.intrinsics[0, 0] for half, depth, camera in zip(half_diagonals, depths, cameras, strict=True))
    return ObjectSphere(centre, float(radius))


@dataclass(frozen=True)
class Crop:
    """The part of a resampled image around its object.

    Attributes:
        camera: pinhole camera of the crop, in normalized coordinates.
        size_px: width and height of the whole image, resampled.
        window: rows and columns of the crop in it.
        active: (H, W) bool, the pixels that count: the object and the border around it.
    """

    camera: Camera
    size_px: tuple[int, int]
    window: tuple[slice, slice]
    active: np.ndarray


def crop(camera: Camera, possible: np.ndarray, sphere: ObjectSphere, image_width_px: int, border_px: int) -> Crop:
    """Crop an image, resampled to `image_width_px` (never enlarged), to what may be the object and `border_px` around it.

    Args:
        possible: (height, width) bool, the mask and where it is not sure.
        image_width_px: for objects of a usual size in the image, `USUAL_SHARES`.
    """
    share = 2 * sphere.radius * camera.intrinsics[0, 0] / (camera.project(sphere.centre[None])[1][0] * camera.width_px)
    finer = float(np.clip(share, *USUAL_SHARES)) / share
    width_px = min(round(image_width_px * max(finer, COARSEST)), camera.width_px)
    height_px = round(camera.height_px * width_px / camera.width_px)
    covered = cv2.resize(possible.astype(np.float32), (width_px, height_px), interpolation=cv2.INTER_AREA) > 0
    reach = np.ones((2 * border_px + 1, 2 * border_px + 1), np.uint8)
    active = cv2.dilate(covered.astype(np.uint8), reach).astype(bool)
    ys, xs = np.nonzero(active)
    x0, x1, y0, y1 = xs.min(), xs.max() + 1, ys.min(), ys.max() + 1
    window = (slice(y0, y1), slice(x0, x1))
    small = sphere.normalized(camera).resized(width_px, height_px).cropped(x0, y0, int(x1 - x0), int(y1 - y0))
    return Crop(small, (width_px, height_px), window, active[window])


def crop_for_seeds(camera: Camera, possible: np.ndarray, sphere: ObjectSphere) -> Crop:
    """The crop in which stereo looks for seeds: at full size up to `SEED_WIDTH_PX`."""
    return crop(camera, possible, sphere, SEED_WIDTH_PX, SEED_BORDER_PX)


def grid_camera(camera: Camera) -> Camera:
    """The camera whose pixels are those at which stereo estimates planes: every `STRIDE_PX`-th of each axis."""
    s = STRIDE_PX
    # The centre of pixel i of the grid is the centre of pixel s * i of the image.
    intrinsics = camera.intrinsics / np.array([[s], [s], [1]]) + np.array([[0, 0, 0.5 - 0.5 / s], [0, 0, 0.5 - 0.5 / s], [0, 0, 0]])
    return Camera(camera.name, -(-camera.width_px // s), -(-camera.height_px // s), intrinsics, camera.camera_from_world)
