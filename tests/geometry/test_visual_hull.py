"""What lies beyond the frame is unknown where the object is cut off there, and not the object elsewhere."""

import numpy as np

from helpers.ball_scene import RADIUS, ball_cameras, ball_mask
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.observation.visual_hull import find_inside_masks, measure_hull_depth

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


def test_the_depth_below_a_balls_hull_is_that_below_its_surface():
    cameras = ball_cameras()
    masks = [ball_mask(camera) for camera in cameras]
    depth = measure_hull_depth(POINTS, cameras, masks)
    inside = find_inside_masks(POINTS, cameras, masks)
    assert (depth[~inside] == 0.0).all() and (depth[inside] > 0.0).all()
    below = RADIUS - np.linalg.norm(POINTS, axis=1)
    side = WITHIN & (np.abs(POINTS[:, 2]) < 0.2)
    assert np.abs(depth - below)[side].max() < 0.06  # the hull of twelve views bulges between them, and pixels are 0.02 wide
    assert (depth - below)[WITHIN].min() > -0.03  # above, where no outline runs, the hull is higher than the ball


def test_what_no_photo_limits_is_infinitely_deep():
    [camera] = ball_cameras()[:1]
    assert np.isinf(measure_hull_depth(POINTS, [camera], [np.ones((camera.height_px, camera.width_px), bool)])).all()
