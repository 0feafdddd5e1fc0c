"""Images that show more of the same have more features in common, turned or reduced, too."""

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.image_overlap import count_common_features, describe_view


def test_common_features_tell_overlap():
    scene = cv2.resize(np.random.default_rng(1).integers(0, 255, (40, 80, 3), dtype=np.uint8), (1280, 640), interpolation=cv2.INTER_CUBIC)
    first, near, far = scene[:480, :640], scene[40:520, 160:800], scene[:480, 640:]
    views = [first, near, far, cv2.rotate(first, cv2.ROTATE_90_CLOCKWISE), cv2.resize(near, (480, 360)), np.zeros((60, 80, 3), np.uint8)]
    common = count_common_features([describe_view(view) for view in views])
    assert (common == common.T).all() and not common.diagonal().any() and not common[5].any()
    assert common[0, 3] > 150 and common[1, 4] > 100, "turned and reduced"
    assert common[0, 1] > 4 * max(common[0, 2], 1), "neighbours against views that share nothing"


def test_features_are_taken_from_the_mask_alone():
    scene = cv2.resize(np.random.default_rng(2).integers(0, 255, (30, 40, 3), dtype=np.uint8), (640, 480), interpolation=cv2.INTER_CUBIC)
    mask = np.zeros((480, 640), bool)
    assert len(describe_view(scene, mask)) == 0
    mask[100:300, 200:500] = True
    assert 10 < len(describe_view(scene, mask)) < len(describe_view(scene))
