"""What lies beyond the frame is unknown where the object is cut off there, and not the object elsewhere."""

import numpy as np

from helpers.ball_scene import ball_cameras, ball_mask
from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.visual_hull import find_inside_masks

POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3))
WITHIN = np.linalg.norm(POINTS, axis=1) < 0.55


def cut(camera: Camera, mask: np.ndarray, rows: int) -> tuple[Camera, np.ndarray]:
    """The view without its first rows."""
    intrinsics = camera.intrinsics - np.array([[0, 0, 0], [0, 0, rows], [0, 0, 0]])
    return Camera(camera.name, camera.width_px, camera.height_px - rows, intrinsics, camera.camera_from_world), mask[rows:]


def test_points_that_the_frame_cuts_off_are_kept():
    cameras = ball_cameras()
    masks = [ball_mask(camera) for camera in cameras]
    whole = find_inside_masks(POINTS, cameras, masks)
    assert whole[WITHIN].all()
    for index in range(0, 12, 2):
        top = int(np.nonzero(masks[index])[0].min())
        cameras[index], masks[index] = cut(cameras[index], masks[index], top + 15)
    seen = find_inside_masks(POINTS, cameras, masks)
    assert seen[WITHIN].all() and seen.sum() < 1.3 * whole.sum()


def test_points_off_a_crop_around_the_mask_are_outside():
    [camera] = ball_cameras()[:1]
    mask = ball_mask(camera)
    top = int(np.nonzero(mask)[0].min())
    whole = find_inside_masks(POINTS, [camera], [mask])
    cropped = find_inside_masks(POINTS, *map(lambda part: [part], cut(camera, mask, top - 2)))
    assert np.array_equal(whole, cropped) and 0 < whole.sum() < len(POINTS)
