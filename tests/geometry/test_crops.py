"""Images are taken finer of small objects and coarser of those that fill the image."""

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere, crop
from zeroshop_steps.geometry.cameras.pinhole import Camera

WIDTH, HEIGHT = 3000, 2000


@pytest.mark.parametrize(("share", "width"), [(0.65, 1000), (0.275, 2000), (0.1, 3000), (1.0, 800), (2.0, 600)])
def test_the_width_follows_the_size_of_the_object(share, width):
    intrinsics = np.array([[3000.0, 0, WIDTH / 2], [0, 3000.0, HEIGHT / 2], [0, 0, 1]])
    pose = np.eye(4)
    pose[2, 3] = 5.0
    camera = Camera("0.png", WIDTH, HEIGHT, intrinsics, pose)
    radius = share * WIDTH / 2 * 5.0 / 3000.0
    possible = np.zeros((HEIGHT, WIDTH), bool)
    half = int(min(share, 0.6) * WIDTH / 2)
    possible[HEIGHT // 2 - half : HEIGHT // 2 + half, WIDTH // 2 - half : WIDTH // 2 + half] = True
    made = crop(camera, possible, ObjectSphere(np.zeros(3), radius), 1000, 4)
    assert made.size_px == (width, round(width * HEIGHT / WIDTH))
    assert made.camera.width_px == pytest.approx(2 * half * width / WIDTH + 8, abs=2)
