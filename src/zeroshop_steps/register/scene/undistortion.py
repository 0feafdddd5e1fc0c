"""Undistortion: images, masks, cameras and image points go together from a lens with distortion to a pinhole."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera, to_matrix
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.imaging.images import read_image, write_image, write_mask
from zeroshop_steps.register.scene.image_set import ImageSet, read_masks
from zeroshop_steps.register.scene.pinhole_view import PinholeView, describe_hidden, make_view, make_views, measure_hidden, measure_view
from zeroshop_steps.register.scene.record import Evidence


def undistort(model: pycolmap.Reconstruction, image_set: ImageSet, out: Path) -> tuple[pycolmap.Reconstruction, Evidence]:
    """Write `out`/images, `out`/masks (where there are masks) and `out`/sparse for all registered images, with PINHOLE cameras.

    Images are resampled with bicubic, masks with nearest-neighbour interpolation, by the same map. All are written as
    PNG, so that nothing is compressed twice.

    Args:
        model: cameras of any COLMAP model; left as it is.
        image_set: the images that the model was made from.
        out: folder to fill.

    Returns:
        The model written, whose images are named `STEM.png`; and the lenses that the images had before, with a warning where the
        pinhole cameras do not show all of the object: `lens`, that of all images, or None if there are several; then `lenses` has
        that of each image, by its stem.
    """
    masks = read_masks(image_set) if image_set.masks else {}
    views = make_views(model, masks)
    files = {path.name: path for path in image_set.images}
    pinhole_model = pycolmap.Reconstruction()
    hidden: dict[str, float] = {}
    for camera_id, view in sorted(views.items()):
        view.camera.camera_id = camera_id
        pinhole_model.add_camera_with_trivial_rig(view.camera)
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        lens, view = model.cameras[image.camera_id], views[image.camera_id]
        image_file, pinhole = files[image.name], view.camera
        pixels = view.remap(read_image(image_file), cv2.INTER_CUBIC, cv2.BORDER_REPLICATE)
        write_image(out / "images" / f"{image_file.stem}.png", pixels)
        if image.name in masks:
            hidden[image_set.shown[image.name]] = measure_hidden(lens, pinhole, masks[image.name])
            write_mask(out / "masks" / f"{image_file.stem}.png", _remap_mask(masks[image.name], view))
        points = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        rays = lens.cam_from_img(points)
        points = rays * [pinhole.focal_length_x, pinhole.focal_length_y] + [pinhole.principal_point_x, pinhole.principal_point_y]
        copied = pycolmap.Image(name=f"{image_file.stem}.png", keypoints=points, camera_id=image.camera_id, image_id=image_id)
        pinhole_model.add_image_with_trivial_frame(copied, image.cam_from_world())
    for point_id, point in sorted(model.points3D.items()):
        pinhole_model.add_point3D_with_id(
            point_id, pycolmap.Point3D(xyz=point.xyz, color=point.color, error=point.error, track=point.track)
        )
        for element in point.track.elements:
            pinhole_model.images[element.image_id].set_point3D_for_point2D(element.point2D_idx, point_id)
    pinhole_model.update_point_3d_errors()
    write_reconstruction(pinhole_model, out / "sparse")
    warning = describe_hidden(hidden)
    return pinhole_model, Evidence(_describe_lenses(model, views), warnings=(warning,) if warning else ())


def _describe_lenses(model: pycolmap.Reconstruction, views: dict[int, PinholeView]) -> dict[str, Any]:
    """The lenses of a model, for data that is aligned with the photos as they were taken, and what undistorted photos show of them."""
    lenses = {
        camera_id: {
            "model": camera.model.name,
            "width_px": camera.width,
            "height_px": camera.height,
            "params": [float(p) for p in camera.params],
            "pinhole": {
                "width_px": views[camera_id].camera.width,
                "height_px": views[camera_id].camera.height,
                "params": [float(p) for p in views[camera_id].camera.params],
            },
            "shown_share": round(measure_view(camera, views[camera_id].camera), 3),
        }
        for camera_id, camera in model.cameras.items()
    }
    if len(lenses) == 1:
        return {"lens": next(iter(lenses.values()))}
    images = sorted((model.images[image_id] for image_id in model.reg_image_ids()), key=lambda image: image.name)
    return {"lens": None, "lenses": {Path(image.name).stem: lenses[image.camera_id] for image in images}}


def undistort_masks(model: pycolmap.Reconstruction, image_set: ImageSet) -> tuple[list[Camera], dict[str, np.ndarray]]:
    """Registered cameras as `undistort` would write them, under their images' names, with their undistorted masks; writes nothing.

    Raises:
        StepError: there are no masks.
    """
    masks = read_masks(image_set)
    views = make_views(model, masks)
    cameras, undistorted = [], {}
    for image in sorted((model.images[image_id] for image_id in model.reg_image_ids()), key=lambda image: image.name):
        pinhole = views[image.camera_id].camera
        pose = to_matrix(image.cam_from_world())
        cameras.append(Camera(image.name, pinhole.width, pinhole.height, np.array(pinhole.calibration_matrix()), pose))
        undistorted[image.name] = _remap_mask(masks[image.name], views[image.camera_id])
    return cameras, undistorted


def _remap_mask(mask: np.ndarray, view: PinholeView) -> np.ndarray:
    return view.remap(mask.astype(np.uint8), cv2.INTER_NEAREST, cv2.BORDER_REPLICATE) > 0


def undistort_by_lens(image: np.ndarray, lens: dict[str, Any] | None, interpolation: int, border: int) -> np.ndarray:
    """An (H, W) image of a registered photo's size as its undistorted photo shows it.

    Args:
        image: aligned with the photo as it was taken.
        lens: of the photo, from the registration's record (`record.find_lens`); None without distortion.
        interpolation, border: as for `cv2.remap`.
    """
    if not lens:
        return image
    size = {"width": lens["width_px"], "height": lens["height_px"]}
    camera, pinhole = pycolmap.Camera(model=lens["model"], params=lens["params"], **size), None
    if "pinhole" in lens:
        shown = lens["pinhole"]
        pinhole = pycolmap.Camera(model="PINHOLE", width=shown["width_px"], height=shown["height_px"], params=shown["params"])
    return make_view(camera, pinhole).remap(image, interpolation, border)
