"""Which pinhole camera shows what a lens with distortion showed of the object, and what no such camera shows.

The pinhole has the lens's focal length and the photo's size. A wide lens sees farther: where the object lies beyond the view, the image
grows there, up to what the photo fills without an empty pixel. Without masks, the object is taken to be where all cameras look.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap

MOST_GROWTH = 2.0  # of a side: farther out, a pinhole shows one pixel of the photo in more and more of its own (1 / cos^2 of the angle)
RIM_SHARE = 0.01  # of a side, that lies about an object that is seen whole
LEAST_CUT_SHARE = 0.005  # of the object in a photo: the error of its outline is larger than less
ALL_SHARE = 0.9  # of the cameras: a few may look elsewhere, or be too near


@dataclass(frozen=True)
class PinholeView:
    """What an undistorted image shows.

    Attributes:
        camera: the pinhole camera.
        columns, rows: (height, width) float32 x and y of each of its pixels in the photo, in the convention of `cv2.remap` (pixel
            centres at whole numbers).
    """

    camera: pycolmap.Camera
    columns: np.ndarray
    rows: np.ndarray

    def remap(self, image: np.ndarray, interpolation: int, border: int) -> np.ndarray:
        """An (H, W) or (H, W, C) photo, or what is aligned with it, as this camera shows it."""
        return cv2.remap(image, self.columns, self.rows, interpolation, borderMode=border)


def make_view(lens: pycolmap.Camera, camera: pycolmap.Camera | None = None) -> PinholeView:
    """The view of a pinhole camera where a lens took the photo; without one, that of `make_pinhole` without any object."""
    camera = camera or make_pinhole(lens)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    source = _find_sources(lens, camera, np.stack([x.ravel(), y.ravel()], axis=1)) - 0.5
    columns, rows = source.astype(np.float32).T.reshape(2, camera.height, camera.width)
    return PinholeView(camera, columns, rows)


def make_pinhole(lens: pycolmap.Camera, shown: np.ndarray | None = None) -> pycolmap.Camera:
    """The pinhole camera of a lens that shows the object, without an empty pixel.

    The focal length grows just enough that no pixel is without a source. Where the object needs it, the sides grow.

    Args:
        shown: (N, 2) places in the photos where the object is seen, such as its outline.
    """
    size, centre = np.array([lens.width, lens.height]), _find_centre(lens)
    least = _measure_least_zoom(lens)
    zoom = max(1.0, float(least.max()))
    growth = np.ones(2)
    if shown is not None and len(shown):
        needed = (_project(lens, shown) * zoom / np.where(shown < centre, centre, size - centre)).max(axis=0)
        growth = np.where(needed > 1 - RIM_SHARE, _measure_room(lens), 1.0)
    focal = np.array([lens.focal_length_x, lens.focal_length_y]) * zoom
    grown = _make_camera(np.floor(size * growth + 1e-6), centre, size, focal)
    return grown if _is_filled(lens, grown) else _make_camera(size, centre, size, focal)


def make_views(model: pycolmap.Reconstruction, masks: Mapping[str, np.ndarray]) -> dict[int, PinholeView]:
    """{camera id: view} of the lenses of a model, by pinhole cameras that show the object of all its images where they can; by (height,
    width) bool masks of the images' names, if there are any."""
    places: dict[int, list[np.ndarray]] = {camera_id: [] for camera_id in model.cameras}
    if any(_measure_room(lens).max() > 1 for lens in model.cameras.values()):
        for camera_id, found in _find_outlines(model, masks) if masks else _find_common_points(model):
            places[camera_id].append(found)
    return {
        camera_id: make_view(lens, make_pinhole(lens, np.concatenate([np.zeros((0, 2)), *places[camera_id]])))
        for camera_id, lens in model.cameras.items()
    }


def measure_hidden(lens: pycolmap.Camera, camera: pycolmap.Camera, mask: np.ndarray) -> float:
    """The share of the object, an (H, W) bool mask in the photo, that a pinhole camera of its lens does not show."""
    if _shows(lens, camera, _trace(mask)).all():
        return 0.0
    rows, columns = np.nonzero(mask)
    return 1.0 - float(_shows(lens, camera, np.stack([columns, rows], axis=1) + 0.5).mean())


def measure_view(lens: pycolmap.Camera, camera: pycolmap.Camera) -> float:
    """The share of the photo that a pinhole camera of its lens shows, by every tenth pixel along its sides."""
    x, y = np.meshgrid(np.arange(0, lens.width, 10) + 0.5, np.arange(0, lens.height, 10) + 0.5)
    return float(_shows(lens, camera, np.stack([x.ravel(), y.ravel()], axis=1)).mean())


def describe_hidden(hidden: dict[str, float]) -> str | None:
    """The warning for the shares of the object that undistorted photos do not show, by the user's names; None where none counts."""
    cut = {name: share for name, share in hidden.items() if share > LEAST_CUT_SHARE}
    if not cut:
        return None
    return (
        f"undistorted photos do not show all of the object: up to {max(cut.values()):.0%} of it is lost in {', '.join(sorted(cut))}. It"
        " lies at the rim of a lens that bends too much there for a pinhole camera, and is cut off as if the photo ended there: take"
        " photos with the object nearer to their middle, step back, or use the 1x lens, or the camera's linear mode"
    )


def _make_camera(grown: np.ndarray, centre: np.ndarray, size: np.ndarray, focal: np.ndarray) -> pycolmap.Camera:
    """The principal point keeps its share of the sides."""
    params = [*focal, *(centre * grown / size)]
    return pycolmap.Camera(model="PINHOLE", width=int(grown[0]), height=int(grown[1]), params=params)


def _find_centre(lens: pycolmap.Camera) -> np.ndarray:
    return np.array([lens.principal_point_x, lens.principal_point_y])


def _list_edges(camera: pycolmap.Camera) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the pixels at the left and right edge, and of those at the upper and lower one."""
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    upright = [np.stack([np.full(len(y), place), y], axis=1) for place in (0.5, camera.width - 0.5)]
    level = [np.stack([x, np.full(len(x), place)], axis=1) for place in (0.5, camera.height - 0.5)]
    return np.concatenate(upright), np.concatenate(level)


def _project(lens: pycolmap.Camera, places: np.ndarray) -> np.ndarray:
    """(N, 2) distances from the principal point, in pixels of a pinhole of the lens's focal length; infinite where no pinhole sees them."""
    rays = np.asarray(lens.cam_from_img(places), dtype=float)
    with np.errstate(invalid="ignore"):
        again = np.asarray(lens.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1)))
        seen = np.linalg.norm(again - places, axis=1) < 0.5  # beyond 90 degrees, or where the model folds, the ray is another one
    return np.where(seen[:, None], np.abs(rays * [lens.focal_length_x, lens.focal_length_y]), np.inf)


def _measure_least_zoom(lens: pycolmap.Camera) -> np.ndarray:
    """(2,) least factors of the focal length with which the left and right, upper and lower edges of the photo lie at or beyond the
    pinhole's."""
    reach = [np.abs(edge - _find_centre(lens))[:, axis] / _project(lens, edge)[:, axis] for axis, edge in enumerate(_list_edges(lens))]
    return np.array([shares.max() for shares in reach])


def _measure_room(lens: pycolmap.Camera) -> np.ndarray:
    """(2,) factors by which the sides of a pinhole's image may grow until the photo no longer fills it, at most `MOST_GROWTH`."""
    least = _measure_least_zoom(lens)
    return np.clip(max(1.0, float(least.max())) / np.maximum(least, 1 / MOST_GROWTH), 1.0, MOST_GROWTH)


def _find_sources(lens: pycolmap.Camera, camera: pycolmap.Camera, pixels: np.ndarray) -> np.ndarray:
    """(N, 2) places in the photo of (N, 2) pixels of the pinhole camera."""
    rays = (pixels - _find_centre(camera)) / [camera.focal_length_x, camera.focal_length_y]
    return np.asarray(lens.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1)))


def _is_filled(lens: pycolmap.Camera, camera: pycolmap.Camera) -> bool:
    """Whether the edges of a pinhole's image lie in the photo."""
    source = _find_sources(lens, camera, np.concatenate(_list_edges(camera)))
    return bool(((source > -0.01) & (source < np.array([lens.width, lens.height]) + 0.01)).all())


def _shows(lens: pycolmap.Camera, camera: pycolmap.Camera, places: np.ndarray) -> np.ndarray:
    """(N,) bool: whether a pinhole camera shows (N, 2) places of the photo, to half a pixel."""
    zoom = camera.focal_length_x / lens.focal_length_x
    centre = _find_centre(camera)
    room = np.where(places < _find_centre(lens), centre, np.array([camera.width, camera.height]) - centre)
    return np.asarray((_project(lens, places) * zoom <= room + 0.5).all(axis=1))


def _trace(mask: np.ndarray) -> np.ndarray:
    """(N, 2) middles of the pixels along the outlines of an (H, W) bool mask."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.concatenate([np.zeros((0, 2)), *(outline[:, 0] + 0.5 for outline in outlines)])


def _find_outlines(model: pycolmap.Reconstruction, masks: Mapping[str, np.ndarray]) -> Iterable[tuple[int, np.ndarray]]:
    """(camera id, outline) of each registered image with a mask."""
    images = [model.images[image_id] for image_id in model.reg_image_ids()]
    return [(image.camera_id, _trace(masks[image.name])) for image in images if image.name in masks]


def _find_common_points(model: pycolmap.Reconstruction) -> Iterable[tuple[int, np.ndarray]]:
    """(camera id, places) of the points in each image that lie in the photos of all cameras: the object does."""
    images = [model.images[image_id] for image_id in model.reg_image_ids()]
    points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
    places, inside = [], []
    for image in images:
        lens, from_world = model.cameras[image.camera_id], image.cam_from_world().matrix()
        local = points @ from_world[:, :3].T + from_world[:, 3]
        ahead = local[:, 2] > 0
        place = np.full((len(points), 2), -1.0)
        place[ahead] = np.asarray(lens.img_from_cam(local[ahead])).reshape(-1, 2)
        places.append(place)
        inside.append(((place >= 0) & (place <= [lens.width, lens.height])).all(axis=1))
    common = np.mean(inside, axis=0) >= ALL_SHARE if images else np.zeros(len(points), bool)
    return [(image.camera_id, place[common & seen]) for image, place, seen in zip(images, places, inside, strict=True)]
