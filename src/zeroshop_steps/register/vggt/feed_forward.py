"""The network's own cameras as a model, and whether masks and depth bear them out."""

from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.scene.image_set import REFERENCE_PX, ImageSet, read_masks
from zeroshop_steps.register.silhouettes.coherence import measure_silhouette_coherence
from zeroshop_steps.register.vggt.dense_points import DensePoints


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
        k = camera.intrinsics
        params = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        lens = pycolmap.Camera(model="PINHOLE", width=camera.width_px, height=camera.height_px, params=params, camera_id=view + 1)
        model.add_camera_with_trivial_rig(lens)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(camera.camera_from_world[:3, :3]), camera.camera_from_world[:3, 3])
        keypoints = np.array(places[view]).reshape(-1, 2)
        image = pycolmap.Image(name=camera.name, keypoints=keypoints, camera_id=view + 1, image_id=view + 1)
        model.add_image_with_trivial_frame(image, pose)
    for index, (xyz, color, track) in enumerate(zip(points.xyz, points.colors, tracks, strict=True), start=1):
        model.add_point3D_with_id(index, pycolmap.Point3D(xyz=xyz, color=color, track=pycolmap.Track(track)))
        for element in track:
            model.images[element.image_id].set_point3D_for_point2D(element.point2D_idx, index)
    model.update_point_3d_errors()
    return model


def check_feed_forward(
    cameras: list[Camera], points: DensePoints, image_set: ImageSet, unexplained_px: float, min_agreement: float, remedy: str
) -> tuple[str | None, dict[str, Any]]:
    """Why the cameras are wrong (None where depth and masks bear them out), and the figures behind that.

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
    return reason, figures
