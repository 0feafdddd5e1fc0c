"""The cases whose errors and scores are recorded in bop/reference.json, made by arithmetic alone so that both sides have the same.

reference.json was recorded from github.com/thodan/bop_toolkit at cea62d651c7e395b2e1962b9749e4e89693c6ac4: `mssd` and `mspd`
by pose_error.mssd and mspd with misc.get_symmetry_transformations(info, 0.01); `vsd` by pose_error.vsd with a renderer that
returned the depth images below, cost type step; `recall` by pose_matching.match_poses_scene and
score.calc_localization_scores; `ap` by COCOeval of github.com/MartinSmeyer/cocoapi at
6237ed6f4a37c836911119c3652ffcc7109eacf8, which bop_toolkit evaluates with, on annotations as in scripts/calc_gt_coco.py.
"""

import numpy as np
from scipy.spatial.transform import Rotation

INTRINSICS = np.array([[110.0, 0.0, 31.3], [0.0, 112.0, 22.7], [0.0, 0.0, 1.0]])
DIAMETER_MM = 120.0
HALF_TURN = [-1, 0, 0, 3, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
MODELS_INFO = {
    "none": {"diameter": DIAMETER_MM},
    "discrete": {"diameter": DIAMETER_MM, "symmetries_discrete": [HALF_TURN]},
    "continuous": {"diameter": DIAMETER_MM, "symmetries_continuous": [{"axis": [0, 0.6, 0.8], "offset": [1, -2, 0.5]}]},
    "both": {
        "diameter": DIAMETER_MM,
        "symmetries_discrete": [HALF_TURN],
        "symmetries_continuous": [{"axis": [0, 0, 2], "offset": [0, 1, 0]}],
    },
}
POSES_A_MODEL = 12


def points() -> np.ndarray:
    """(300, 3) vertices within a box, mm."""
    return np.random.default_rng(1).uniform([-40, -30, -25], [40, 30, 25], (300, 3))


def poses(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4, 4) estimated and true poses: random ones, half of them near each other."""
    rng = np.random.default_rng([2, seed])
    true, estimated = np.tile(np.eye(4), (POSES_A_MODEL, 1, 1)), np.tile(np.eye(4), (POSES_A_MODEL, 1, 1))
    true[:, :3, :3] = Rotation.from_quat(rng.normal(size=(POSES_A_MODEL, 4))).as_matrix()
    true[:, :3, 3] = rng.uniform([-60, -50, 500], [60, 50, 900], (POSES_A_MODEL, 3))
    turn = Rotation.from_rotvec(rng.normal(0, 0.05, (POSES_A_MODEL, 3))).as_matrix()
    estimated[:, :3, :3] = turn @ true[:, :3, :3]
    estimated[::2, :3, :3] = Rotation.from_quat(rng.normal(size=(len(true[::2]), 4))).as_matrix()
    estimated[:, :3, 3] = true[:, :3, 3] + rng.normal(0, 8, (POSES_A_MODEL, 3))
    return estimated, true


def ball_depth(centre_mm: np.ndarray, radius_mm: float, width_px: int = 64, height_px: int = 48) -> np.ndarray:
    """(height, width) float32 depth of a ball, 0 beside it."""
    x, y = np.meshgrid(np.arange(width_px), np.arange(height_px))
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(INTRINSICS).T
    a, b = (rays**2).sum(-1), rays @ centre_mm
    root = b**2 - a * (centre_mm @ centre_mm - radius_mm**2)
    return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0.0).astype(np.float32)


def visible_surface_cases() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(measured, estimated, true) depth images: a ball before a wall, partly hidden, with noise and holes; the last is out of sight."""
    rng = np.random.default_rng(3)
    cases = []
    for index in range(8):
        centre = np.array([rng.uniform(-40, 40), rng.uniform(-30, 30), 600.0])
        true = ball_depth(centre, DIAMETER_MM / 2)
        estimated = ball_depth(centre + rng.normal(0, [12, 12, 25]), DIAMETER_MM / 2)
        hider = ball_depth(centre + [rng.uniform(-60, 60), 20, -90], 30.0)
        measured = np.where(true > 0, true, 700.0)
        measured = np.where(hider > 0, hider, measured) + rng.normal(0, 6, true.shape)
        measured[rng.uniform(size=true.shape) < 0.1] = 0
        if index == 7:
            estimated = true = np.zeros_like(true)
        cases.append((measured.astype(np.float32), estimated, true))
    return cases


def matching_cases() -> list[dict]:
    """Images of one object with several instances and estimates; `valid` instances count, the surest `count` estimates too."""
    rng = np.random.default_rng(4)
    cases = []
    for _ in range(40):
        instances, estimates = int(rng.integers(1, 5)), int(rng.integers(0, 5))
        count = int(rng.integers(1, instances + 1))
        cases.append(
            {
                "visible": rng.permutation(instances).tolist(),
                "count": count,
                "scores": np.round(rng.uniform(size=estimates), 3).tolist(),
                "errors": np.round(rng.uniform(0, 0.6, (estimates, instances)), 4).tolist(),
            }
        )
    return cases


def detection_cases() -> tuple[list[dict], list[dict]]:
    """Instances (image, object, mask, visible share) and detections (image, object, mask, score) of rectangles in 64 x 48 px."""
    rng = np.random.default_rng(5)
    instances, detections = [], []
    for image in range(6):
        for _ in range(5):
            left, top, width, height = rng.integers([0, 0, 8, 8], [40, 24, 24, 24])
            number = int(rng.integers(1, 4))
            mask = np.zeros((48, 64), bool)
            mask[top : top + height, left : left + width] = True
            instances.append({"image": image, "object": number, "mask": mask, "visible": float(rng.choice([0.05, 0.5, 0.9]))})
            if rng.uniform() < 0.8:
                moved = np.roll(mask, rng.integers(-3, 4, 2), (0, 1))
                detections.append({"image": image, "object": number, "mask": moved, "score": float(np.round(rng.uniform(), 3))})
        detections.append({"image": image, "object": int(rng.integers(1, 4)), "mask": np.roll(mask, 9, 1), "score": 0.5})
    return instances, detections
