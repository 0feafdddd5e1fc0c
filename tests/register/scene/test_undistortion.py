"""Undistortion keeps images, masks, cameras and points together."""

import cv2
import numpy as np
import pycolmap
import pytest

from zeroshop_steps.geometry.imaging.images import read_image, read_mask, write_image, write_mask
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.pinhole_view import make_pinhole, make_view
from zeroshop_steps.register.scene.undistortion import undistort, undistort_by_lens

WIDTH, HEIGHT = 160, 120


def lens(distortion: float) -> pycolmap.Camera:
    return pycolmap.Camera(
        model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[150.0, WIDTH / 2, HEIGHT / 2, distortion], camera_id=1
    )


@pytest.mark.parametrize("distortion", [-0.3, -0.05, 0.0, 0.05, 0.3])
def test_every_pixel_has_a_source(distortion):
    view = make_view(lens(distortion))
    pinhole, map_x, map_y = view.camera, view.columns, view.rows
    assert pinhole.model.name == "PINHOLE" and (pinhole.width, pinhole.height) == (WIDTH, HEIGHT)
    assert map_x.min() > -0.51 and map_x.max() < WIDTH - 0.49
    assert map_y.min() > -0.51 and map_y.max() < HEIGHT - 0.49


def test_no_distortion_changes_nothing():
    view = make_view(lens(0.0))
    pinhole, map_x, map_y = view.camera, view.columns, view.rows
    assert pinhole.focal_length_x == pytest.approx(150.0, rel=1e-9)
    assert np.abs(map_x - np.arange(WIDTH)).max() < 1e-4 and np.abs(map_y - np.arange(HEIGHT)[:, None]).max() < 1e-4


def distorted_scene(folder, distortion: float) -> tuple[pycolmap.Reconstruction, ImageSet]:
    """One picture of a bright disk, its mask, and a model with a point at the disk's centre."""
    camera = lens(distortion)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    disk = np.hypot(x - 120, y - 80) < 20
    write_image(folder / "images" / "000000.png", np.where(disk, 255, 0).astype(np.uint8)[..., None].repeat(3, axis=2))
    write_mask(folder / "masks" / "000000.png", disk)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(name="000000.png", keypoints=np.array([[120.0, 80.0]]), camera_id=1, image_id=1)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    ray = camera.cam_from_img(np.array([[120.0, 80.0]]))[0]
    model.add_point3D(np.array([*ray, 1.0]) * 5, pycolmap.Track([pycolmap.TrackElement(1, 0)]), np.zeros(3, np.uint8))
    return model, ImageSet((folder / "images" / "000000.png",), (folder / "masks" / "000000.png",), ((WIDTH, HEIGHT),))


@pytest.mark.parametrize("distortion", [-0.2, 1e-6, 0.2])
def test_image_mask_and_points_move_alike(tmp_path, distortion):
    model, image_set = distorted_scene(tmp_path, distortion)
    undistort(model, image_set, tmp_path / "out")
    mask = read_mask(tmp_path / "out" / "masks" / "000000.png", (WIDTH, HEIGHT))
    bright = read_image(tmp_path / "out" / "images" / "000000.png")[..., 0] > 127
    assert (mask != bright).sum() <= 0.02 * mask.sum()
    written = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse"))
    (point,), (image,) = written.points3D.values(), written.images.values()
    projected = image.project_point(point.xyz)
    assert projected == pytest.approx(image.points2D[0].xy, abs=1e-6)
    rows, columns = np.nonzero(mask)
    assert projected == pytest.approx([columns.mean() + 0.5, rows.mean() + 0.5], abs=0.7)


FISHEYE = pycolmap.Camera(
    model="OPENCV_FISHEYE", width=WIDTH, height=HEIGHT, params=[72.0, 72.0, WIDTH / 2, HEIGHT / 2, 0.1, 0.05, 0, 0], camera_id=1
)


def fisheye_scene(folder, middles, masked: bool = True) -> tuple[pycolmap.Reconstruction, ImageSet]:
    """Photos through a fisheye, from one place, of bright disks of radius 12 about these middles; points on the disks."""
    model, images, masks = pycolmap.Reconstruction(), [], []
    model.add_camera_with_trivial_rig(FISHEYE)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    angles = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    for number, middle in enumerate(middles):
        disk = np.hypot(x - middle[0], y - middle[1]) < 12
        images.append(folder / f"images/{number:06d}.png")
        masks.append(folder / f"masks/{number:06d}.png")
        write_image(images[-1], np.where(disk, 255, 0).astype(np.uint8)[..., None].repeat(3, axis=2))
        write_mask(masks[-1], disk)
        rim = np.array(middle) + 11 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        image = pycolmap.Image(name=images[-1].name, keypoints=rim, camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
        for place, ray in enumerate(FISHEYE.cam_from_img(rim)):
            model.add_point3D(np.array([*ray, 1.0]), pycolmap.Track([pycolmap.TrackElement(number + 1, place)]), np.zeros(3, np.uint8))
    return model, ImageSet(tuple(images), tuple(masks) if masked else None, ((WIDTH, HEIGHT),) * len(images))


@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize(("middle", "grown"), [((80, 60), (False, False)), ((145, 60), (True, False)), ((80, 106), (False, True))])
def test_a_wide_lens_shows_the_object_at_its_rim(tmp_path, middle, grown, masked):
    model, image_set = fisheye_scene(tmp_path, [middle], masked)
    pinhole_model, lenses = undistort(model, image_set, tmp_path / "out")
    (camera,) = pinhole_model.cameras.values()
    assert (camera.width > WIDTH, camera.height > HEIGHT) == grown and camera.focal_length_x == 72.0
    shown = read_image(tmp_path / "out/images/000000.png")[..., 0] > 127
    assert shown.shape == (camera.height, camera.width)
    assert shown.any() and not (shown[[0, -1]].any() or shown[:, [0, -1]].any()), "whole, not cut off at the border"
    assert not lenses.warnings
    view = make_view(FISHEYE, camera)
    assert view.columns.min() > -0.6 and view.columns.max() < WIDTH - 0.4 and view.rows.min() > -0.6 and view.rows.max() < HEIGHT - 0.4
    depth = undistort_by_lens(read_image(image_set.images[0])[..., 0], lenses.entries["lens"], cv2.INTER_CUBIC, cv2.BORDER_REPLICATE)
    assert np.array_equal(depth > 127, shown), "what is aligned with the photo goes the same way"


def test_what_no_pinhole_shows_of_the_object_is_told(tmp_path):
    model, image_set = fisheye_scene(tmp_path, [(80, 60), (146, 106), (14, 60)])
    _, lenses = undistort(model, image_set, tmp_path / "out")
    (warning,) = lenses.warnings
    share = 1 - (read_mask(image_set.masks[1]) & make_seen(lenses.entries["lens"])).sum() / read_mask(image_set.masks[1]).sum()
    assert share > 0.2 and f"up to {share:.0%} of it is lost in 000001.png" in warning
    assert "000000.png" not in warning and "000002.png" not in warning and "nearer to their middle" in warning


def make_seen(lens) -> np.ndarray:
    """(HEIGHT, WIDTH) bool: pixels of the photo that the undistorted one shows."""
    shown = lens["pinhole"]
    rays = FISHEYE.cam_from_img(np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), axis=-1).reshape(-1, 2))
    places = rays * shown["params"][:2] + shown["params"][2:]
    inside = (places > -0.5) & (places < np.array([shown["width_px"], shown["height_px"]]) + 0.5)
    return inside.all(axis=1).reshape(HEIGHT, WIDTH)


def test_what_lies_beyond_a_right_angle_is_never_shown():
    """An image circle of 200 degrees in the photo: no pinhole sees all of it, and none grows without end."""
    wide = pycolmap.Camera(model="OPENCV_FISHEYE", width=WIDTH, height=WIDTH, params=[45.0, 45.0, WIDTH / 2, WIDTH / 2, 0, 0, 0, 0])
    pinhole = make_pinhole(wide, np.array([[1.0, WIDTH / 2], [40.0, 40.0]]))
    assert (pinhole.width, pinhole.height) == (2 * WIDTH, 2 * WIDTH)
