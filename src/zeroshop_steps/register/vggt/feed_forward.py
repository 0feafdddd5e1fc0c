"""What a network says, as cameras and points of the full images, as a model, and whether masks and depth bear them out."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform, to_rigid
from zeroshop_steps.register.scene.image_set import REFERENCE_PX, ImageSet, read_masks
from zeroshop_steps.register.scene.record import Evidence, Fault, RegistrationFailed
from zeroshop_steps.register.silhouettes.coherence import measure_silhouette_coherence
from zeroshop_steps.register.vggt.frames import Frames

FOV_DEG = (2.0, 170.0)  # no lens beyond; the network's output is not bounded


@dataclass(frozen=True)
class DensePoints:
    """Points of the depth maps that other views confirm.

    Attributes:
        xyz: (P, 3) in the world.
        xy: (P, 2) image position in the view that it comes from; `view`: (P,) that view.
        seen: (P, S) bool: the views whose depth agrees, its own among them.
        colors: (P, 3) uint8 RGB.
        agreement: (S,) share of each view's points, of those that some other view should see, that one confirms.
    """

    xyz: np.ndarray
    xy: np.ndarray
    view: np.ndarray
    seen: np.ndarray
    colors: np.ndarray
    agreement: np.ndarray


def decode_cameras(encodings: np.ndarray, frames: Frames) -> list[Camera]:
    """The cameras of the full images from (S, 9) encodings: translation, quaternion (x, y, z, w) of camera_from_world, fields of view.

    The field of view, vertical then horizontal, is that of what the network saw; the principal point is the centre.

    Raises:
        RegistrationFailed: a camera that is none.
    """
    cameras = []
    for name, row in zip(frames.names, encodings.astype(np.float64), strict=True):
        fov_deg = np.degrees(row[[8, 7]])
        if not np.isfinite(row).all() or not np.linalg.norm(row[3:7]) > 1e-6 or not ((FOV_DEG[0] < fov_deg) & (fov_deg < FOV_DEG[1])).all():
            raise RegistrationFailed(
                f"the network found no camera for {name} (fields of view {fov_deg[0]:.1f} x {fov_deg[1]:.1f} degrees); these pictures are "
                "too unlike what it was trained on, or its weights are not trained: use the registration colmap",
                {},
            )
        focal = np.array(frames.network_size_px) / 2 / np.tan(np.radians(fov_deg) / 2) / frames.scale
        intrinsics = np.array([[focal[0], 0.0, frames.size_px[0] / 2], [0.0, focal[1], frames.size_px[1] / 2], [0.0, 0.0, 1.0]])
        camera_from_world = make_transform(Rotation.from_quat(row[3:7]).as_matrix(), row[:3])
        cameras.append(Camera(name, *frames.size_px, intrinsics, camera_from_world))
    return cameras


def unproject(camera: Camera, xy: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(N, 3) world points at (N, 2) image positions and (N,) depths along the optical axis."""
    rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(camera.intrinsics).T
    return (rays * depth[:, None] - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]


def find_confirmed_points(
    cameras: list[Camera],
    frames: Frames,
    depth: np.ndarray,
    sure: np.ndarray,
    max_points: int = 50_000,
    tolerance: float = 0.02,
) -> DensePoints:
    """Points of all views that at least one other view's depth confirms, and how many do.

    Args:
        cameras: of the full images.
        frames: what the network saw.
        depth: (S, height, width) along the optical axis, one value a network pixel.
        sure: (S, height, width) bool: pixels to take points from, and to ask.
        max_points: pixels that are tried, evenly spread.
        tolerance: depths agree within this share.
    """
    candidates = np.flatnonzero(sure & np.isfinite(depth) & (depth > 0))
    chosen = candidates[np.unique(np.linspace(0, max(len(candidates) - 1, 0), min(max_points, len(candidates))).astype(int))]
    view, row, column = np.unravel_index(chosen, depth.shape)
    xy = frames.to_image(np.column_stack([column, row]).astype(np.float64).reshape(-1, 2))
    xyz = np.zeros((len(chosen), 3))
    for index, camera in enumerate(cameras):
        own = view == index
        xyz[own] = unproject(camera, xy[own], depth[index, row[own], column[own]].astype(np.float64))
    seen, asked = np.zeros((2, len(chosen), len(cameras)), bool)
    for index, camera in enumerate(cameras):
        seen[:, index], asked[:, index] = _compare_depth(camera, frames, depth[index], sure[index], xyz, tolerance)
        seen[view == index, index] = True
        asked[view == index, index] = False
    others = seen.sum(1) - 1
    agreement = np.array([_compute_share(others[(view == index) & asked.any(1)] > 0) for index in range(len(cameras))])
    kept = others > 0
    colors = np.rint(255 * frames.pixels[view, :, row, column]).astype(np.uint8)
    return DensePoints(xyz[kept], xy[kept], view[kept], seen[kept], colors[kept], agreement)


def _compute_share(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else 0.0


def _compare_depth(
    camera: Camera, frames: Frames, depth: np.ndarray, sure: np.ndarray, xyz: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """(P,) bool: where a view's depth is that of the points; where it has a depth for them and does not see something before them."""
    pixels, distance = camera.project(xyz)
    with np.errstate(invalid="ignore"):
        columns, rows = np.rint(np.nan_to_num(frames.to_network(pixels), nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(np.int64).T
    inside = (distance > 0) & (columns >= 0) & (rows >= 0) & (columns < depth.shape[1]) & (rows < depth.shape[0])
    found = np.where(inside, depth[np.where(inside, rows, 0), np.where(inside, columns, 0)], np.nan)
    known = inside & np.where(inside, sure[np.where(inside, rows, 0), np.where(inside, columns, 0)], False)
    with np.errstate(invalid="ignore"):
        hidden = found < distance * (1 - tolerance)
        return known & (np.abs(found - distance) <= tolerance * distance), known & ~hidden


def build_feed_forward_model(cameras: list[Camera], points: DensePoints) -> pycolmap.Reconstruction:
    """A COLMAP model with a pinhole camera an image, and the points with one observation in every view that confirms them."""
    model = pycolmap.Reconstruction()
    places: list[list] = [[] for _ in cameras]
    tracks: list[list[pycolmap.TrackElement]] = [[] for _ in points.xyz]
    for view, camera in enumerate(cameras):
        pixels, _ = camera.project(points.xyz)
        for point in np.flatnonzero(points.seen[:, view]):
            tracks[point].append(pycolmap.TrackElement(view + 1, len(places[view])))
            places[view].append(points.xy[point] if points.view[point] == view else pixels[point])
    for view, camera in enumerate(cameras):
        size = {"width": camera.width_px, "height": camera.height_px}
        model.add_camera_with_trivial_rig(pycolmap.Camera(model="PINHOLE", params=camera.pinhole_params, camera_id=view + 1, **size))
        keypoints = np.array(places[view]).reshape(-1, 2)
        image = pycolmap.Image(name=camera.name, keypoints=keypoints, camera_id=view + 1, image_id=view + 1)
        model.add_image_with_trivial_frame(image, to_rigid(camera.camera_from_world))
    for xyz, color, track in zip(points.xyz, points.colors, tracks, strict=True):
        model.add_point3D(xyz, pycolmap.Track(track), color)
    model.update_point_3d_errors()
    return model


def check_feed_forward(
    cameras: list[Camera], points: DensePoints, image_set: ImageSet, unexplained_px: float, min_agreement: float, remedy: str
) -> Evidence:
    """Whether depth and masks bear the cameras out: the figures, and the fault where they do not.

    Args:
        cameras: of all images.
        points: what views confirm of each other.
        image_set: the masks, if there are any.
        unexplained_px: mask rays may miss the other masks by this much, per 1000 px of width.
        min_agreement: share of an image's points that other views must confirm.
        remedy: what to do about it, for the user.
    """
    names = [camera.name for camera in cameras]
    figures: dict[str, Any] = {"depth_agreement": dict(zip(names, np.round(points.agreement, 3).tolist(), strict=True))}
    worst = int(points.agreement.argmin())
    reason = None
    if points.agreement[worst] < min_agreement:
        found = f"other views confirm only {points.agreement[worst]:.0%} of the depth of {names[worst]}"
        reason = f"{found}, {min_agreement:.0%} is needed; {remedy}"
    if image_set.masks is not None:
        coherence = measure_silhouette_coherence(cameras, read_masks(image_set))
        figures["silhouette_px"] = dict(zip(names, np.round(coherence.unexplained_px, 2).tolist(), strict=True))
        worst_px = float(coherence.unexplained_px.max())
        if reason is None and worst_px > unexplained_px * max(image_set.size_px) / REFERENCE_PX:
            name = names[int(coherence.unexplained_px.argmax())]
            reason = f"rays through the mask of {name} miss the other masks by {worst_px:.1f} px; check the masks, {remedy}"
    return Evidence({"consistency": figures}, fault=Fault(reason) if reason else None)
