"""What one view shows of a plane is carried into another, and scored there."""

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.photometry.score import compare_patches, find_peak, measure_chance
from zeroshop_steps.register.photometry.transfer import carry_by_plane

SIZE = 80


def look(angle_deg: float) -> Camera:
    """A camera at a distance of 4 from the origin, turned about the y axis."""
    angle = np.radians(angle_deg)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[2, 3] = 4.0
    intrinsics = np.array([[200.0, 0, SIZE / 2], [0, 200.0, SIZE / 2], [0, 0, 1]])
    return Camera(f"{angle_deg}.png", SIZE, SIZE, intrinsics, pose)


def paint(camera: Camera, normal: np.ndarray) -> np.ndarray:
    """(SIZE, SIZE) picture of a plane through the origin with smooth print."""
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    rays = pixels @ np.linalg.inv(camera.intrinsics).T @ camera.camera_from_world[:3, :3]
    points = camera.centre_in_world - rays * ((camera.centre_in_world @ normal) / (rays @ normal))[..., None]
    return (128 + 50 * np.sin(9 * points[..., 0] + 4 * points[..., 1]) + 50 * np.cos(11 * points[..., 1])).astype(np.float32)


def test_a_plane_is_carried_to_where_the_other_view_has_it():
    normal = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    one, other, half = look(0.0), look(25.0), 6
    carried = carry_by_plane(np.zeros(3), normal, paint(one, normal), one, other, half)
    middle = SIZE // 2
    shown = paint(other, normal)[middle - half : middle + half + 1, middle - half : middle + half + 1]
    turned = carry_by_plane(np.zeros(3), np.array([-0.6, 0.0, 0.8]), paint(one, normal), one, other, half)
    # The patch begins at the pixel's corner, the picture's pixels have their centres half a pixel on.
    error, wrong = (float(np.abs(part[:-1, :-1] / 2 + part[1:, 1:] / 2 - shown[:-1, :-1]).mean()) for part in (carried, turned))
    assert error < 3.0 < 3 * error + 3.0 < wrong


def test_patches_are_found_where_they_lie_and_only_there():
    rng = np.random.default_rng(0)
    grey = rng.uniform(0, 255, (60, 60)).astype(np.float32)
    seen = np.ones(grey.shape, bool)
    assert compare_patches(grey, np.roll(grey, (2, -1), (0, 1)), seen, 11, 3).min() > 0.99
    assert compare_patches(grey, rng.uniform(0, 255, grey.shape).astype(np.float32), seen, 11, 3).max() < 0.8
    striped = np.tile(grey[:, :10], 6)
    patch = slice(24, 35)
    assert measure_chance(grey, seen, grey[patch, patch], 29, 29, 2, 0.6) == 0.0
    assert measure_chance(striped, seen, striped[patch, patch], 29, 29, 2, 0.6) > 0.01


def test_a_peak_is_taken_only_where_it_stands_alone():
    y, x = np.mgrid[:25, :25].astype(float)

    def bump(column, row, height):
        return height * np.exp(-((x - column) ** 2 + (y - row) ** 2) / 8)

    assert find_peak(bump(12.3, 9.8, 0.95)) == pytest.approx([12.3, 9.8], abs=0.05)
    assert find_peak(bump(12, 10, 0.7)) is None  # not alike
    assert find_peak(bump(24, 10, 0.95)) is None  # beyond the border, perhaps
    assert find_peak(bump(12, 10, 0.95) + bump(5, 18, 0.9)) is None  # print that repeats
    assert find_peak(bump(12, 10, 0.95) + bump(5, 18, 0.6)) is not None
