"""Undistortion: images, masks, cameras and image points go together from a lens with distortion to a pinhole."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.imaging.images import read_image, read_mask, write_image, write_mask
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.runtime.errors import StepError


def undistort(model: pycolmap.Reconstruction, image_set: ImageSet, out: Path) -> pycolmap.Reconstruction:
    """Write `out`/images, `out`/masks (where there are masks) and `out`/sparse for all registered images, with PINHOLE cameras.

    Images are resampled with bicubic, masks with nearest-neighbour interpolation, by the same map. All are written as
    PNG, so that nothing is compressed twice.

    Args:
        model: cameras of any COLMAP model; left as it is.
        image_set: the images that the model was made from.
        out: folder to fill.

    Returns:
        The model written, whose images are named `STEM.png`.
    """
    maps = {camera_id: make_undistortion_map(camera) for camera_id, camera in model.cameras.items()}
    files = {path.name: path for path in image_set.images}
    masks = dict(zip(image_set.names, image_set.masks or (), strict=image_set.masks is not None))
    pinhole_model = pycolmap.Reconstruction()
    for camera_id, (pinhole, _) in sorted(maps.items()):
        pinhole.camera_id = camera_id
        pinhole_model.add_camera_with_trivial_rig(pinhole)
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        pinhole, (map_x, map_y) = maps[image.camera_id]
        image_file = files[image.name]
        pixels = cv2.remap(read_image(image_file), map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        write_image(out / "images" / f"{image_file.stem}.png", pixels)
        if image.name in masks:
            write_mask(out / "masks" / f"{image_file.stem}.png", _remap_mask(masks[image.name], map_x, map_y))
        points = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        rays = model.cameras[image.camera_id].cam_from_img(points)
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
    return pinhole_model


def undistort_masks(model: pycolmap.Reconstruction, image_set: ImageSet) -> tuple[list[Camera], dict[str, np.ndarray]]:
    """Registered cameras as `undistort` would write them, under their images' names, with their undistorted masks; writes nothing.

    Raises:
        StepError: there are no masks.
    """
    if image_set.masks is None:
        raise StepError("a whole scene has no masks to undistort")
    maps = {camera_id: make_undistortion_map(camera) for camera_id, camera in model.cameras.items()}
    masks = dict(zip(image_set.names, image_set.masks, strict=True))
    cameras, undistorted = [], {}
    for image in sorted((model.images[image_id] for image_id in model.reg_image_ids()), key=lambda image: image.name):
        pinhole, (map_x, map_y) = maps[image.camera_id]
        camera_from_world = np.eye(4)
        camera_from_world[:3] = image.cam_from_world().matrix()
        cameras.append(Camera(image.name, pinhole.width, pinhole.height, np.array(pinhole.calibration_matrix()), camera_from_world))
        undistorted[image.name] = _remap_mask(masks[image.name], map_x, map_y)
    return cameras, undistorted


def _remap_mask(path: Path, map_x: np.ndarray, map_y: np.ndarray) -> np.ndarray:
    return cv2.remap(read_mask(path).astype(np.uint8), map_x, map_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0


def undistort_by_lens(image: np.ndarray, lens: dict[str, Any] | None, interpolation: int, border: int) -> np.ndarray:
    """An (H, W) image of a registered photo's size as its undistorted photo shows it.

    Args:
        image: aligned with the photo as it was taken.
        lens: of the photo, from the registration's record (`record.find_lens`); None without distortion.
        interpolation, border: as for `cv2.remap`.
    """
    if not lens:
        return image
    camera = pycolmap.Camera(model=lens["model"], width=lens["width_px"], height=lens["height_px"], params=lens["params"])
    map_x, map_y = make_undistortion_map(camera)[1]
    return cv2.remap(image, map_x, map_y, interpolation, borderMode=border)


def make_undistortion_map(camera: pycolmap.Camera) -> tuple[pycolmap.Camera, tuple[np.ndarray, np.ndarray]]:
    """The pinhole camera of equal size whose whole image lies inside the distorted one, and where it reads from.

    The focal length grows just enough that no pixel is without a source; the principal point stays.

    Returns:
        The pinhole camera, and the (height, width) float32 x and y of each pixel in the distorted image, in the
        convention of `cv2.remap` (pixel centres at whole numbers).
    """
    width, height = camera.width, camera.height
    centre = np.array([camera.principal_point_x, camera.principal_point_y])
    focal = np.array([camera.focal_length_x, camera.focal_length_y])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    edge = pixels[(np.minimum(x, width - x).ravel() < 1) | (np.minimum(y, height - y).ravel() < 1)]
    # Per edge pixel: the ray that the distorted camera sees there must lie on or outside the pinhole's edge.
    rays = camera.cam_from_img(edge)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.abs((edge - centre) / focal) / np.abs(rays)
    at_x = np.minimum(edge[:, 0], width - edge[:, 0]) < 1
    at_y = np.minimum(edge[:, 1], height - edge[:, 1]) < 1
    zoom = max(1.0, float(np.nanmax(reach[at_x, 0])), float(np.nanmax(reach[at_y, 1])))
    params = [focal[0] * zoom, focal[1] * zoom, centre[0], centre[1]]
    pinhole = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=params)
    rays = np.concatenate([(pixels - centre) / params[:2], np.ones((len(pixels), 1))], axis=1)
    source = camera.img_from_cam(rays) - 0.5
    return pinhole, (source[:, 0].reshape(height, width).astype(np.float32), source[:, 1].reshape(height, width).astype(np.float32))
