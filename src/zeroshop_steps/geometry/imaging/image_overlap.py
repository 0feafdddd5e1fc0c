"""How much of the same two images show, from few features of small copies: cheap enough for all pairs of hundreds of images."""

from collections.abc import Sequence

import cv2
import numpy as np

SIDE_PX = 640  # longer side of the copies
FEATURES = 400  # strongest features of a copy
RATIO = 0.8  # a match is nearer than this share of the distance to the second best (Lowe, IJCV 2004)


def describe_view(image: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """(K, 128) float32 unit descriptors of the strongest features of an (H, W, 3) uint8 RGB image, as `find_root_sift` gives them.

    Args:
        image: the image.
        mask: (H, W) bool, where features may lie; None for everywhere.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, SIDE_PX / max(grey.shape))
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    where = None if mask is None else cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_NEAREST)
    return find_root_sift(small, cv2.SIFT.create(nfeatures=FEATURES), where)[1][:FEATURES]


def find_root_sift(grey: np.ndarray, sift: cv2.SIFT, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) float32 places of features in pixels and their (K, 128) float32 unit descriptors.

    RootSIFT (Arandjelovic and Zisserman, CVPR 2012).

    Args:
        grey: (H, W) uint8.
        sift: the detector.
        mask: (H, W) uint8, above 0 where features may lie; None for everywhere.
    """
    keypoints, found = sift.detectAndCompute(grey, mask)
    if not keypoints:
        return np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32)
    places = np.array([keypoint.pt for keypoint in keypoints], np.float32)
    return places, np.sqrt(found / np.maximum(found.sum(1, keepdims=True), 1e-6)).astype(np.float32)


def count_common_features(descriptors: Sequence[np.ndarray]) -> np.ndarray:
    """(N, N) symmetric int: matches between each two views, the smaller number of the two directions; 0 on the diagonal."""
    count = len(descriptors)
    common = np.zeros((count, count), np.int64)
    starts = np.concatenate([[0], np.cumsum([len(one) for one in descriptors])])
    stacked = np.concatenate([*descriptors, np.zeros((0, 128), np.float32)])
    for view, own in enumerate(descriptors):
        if not len(own):
            continue
        likeness = own @ stacked.T
        for other in range(count):
            part = likeness[:, starts[other] : starts[other + 1]]
            if other != view and part.shape[1] > 1:
                common[view, other] = _count_clear_matches(part)
    return np.minimum(common, common.T)


def _count_clear_matches(likeness: np.ndarray) -> int:
    """How many rows have a nearest column that is clearly nearer than the second; entries are cosines of unit vectors."""
    rows, best = np.arange(len(likeness)), likeness.argmax(1)
    nearest = likeness[rows, best]
    likeness[rows, best] = -np.inf
    second = likeness.max(1)
    return int(((1 - nearest) < RATIO**2 * (1 - second)).sum())
