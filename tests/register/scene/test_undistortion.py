"""Undistortion keeps images, masks, cameras and points together."""

import numpy as np
import pycolmap
import pytest

from zeroshop_steps.geometry.imaging.images import read_image, read_mask, write_image, write_mask
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.undistortion import make_undistortion_map, undistort

WIDTH, HEIGHT = 160, 120


def lens(distortion: float) -> pycolmap.Camera:
    return pycolmap.Camera(
        model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[150.0, WIDTH / 2, HEIGHT / 2, distortion], camera_id=1
    )


@pytest.mark.parametrize("distortion", [-0.3, -0.05, 0.0, 0.05, 0.3])
def test_every_pixel_has_a_source(distortion):
    pinhole, (map_x, map_y) = make_undistortion_map(lens(distortion))
    assert pinhole.model.name == "PINHOLE" and (pinhole.width, pinhole.height) == (WIDTH, HEIGHT)
    assert map_x.min() > -0.51 and map_x.max() < WIDTH - 0.49
    assert map_y.min() > -0.51 and map_y.max() < HEIGHT - 0.49


def test_no_distortion_changes_nothing():
    pinhole, (map_x, map_y) = make_undistortion_map(lens(0.0))
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
