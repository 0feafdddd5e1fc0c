"""Repair a model: refine it robustly, take suspicious images out and register them again with a strict error limit.

A face of a box, seen through a long lens, looks nearly the same from two mirrored sides (the two-fold ambiguity of
plane-based pose, Oberkampf et al. 1996). The mapper tolerates large errors at first, because the model is still rough;
so an image can be registered on the wrong side, from where bundle adjustment does not return. Once the rest of the model is
accurate, a strict error limit tells the two sides apart.
"""

import shutil
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.register.mapping.mapper import adjust_robustly, make_mapping_options
from zeroshop_steps.register.scene.image_set import REFERENCE_PX

STRICT_ERROR_PX = 3.0  # of absolute pose estimation, per 1000 px of the images' longer side
LOSS_SCALE_PX = 0.5  # of the Cauchy loss; a good match is within 0.3 px
ITERATIONS = 50  # of bundle adjustment, at most
MIN_ANGLE_DEG = pycolmap.IncrementalMapperOptions().filter_min_tri_angle  # between the rays to a point


def measure_reprojection_errors_px(model: pycolmap.Reconstruction) -> dict[str, float]:
    """{image name: median reprojection error of its points}, where a point behind the image, or at its side, misses by infinity."""
    errors = {}
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        camera = model.cameras[image.camera_id]
        observed = [point for point in image.points2D if point.has_point3D()]
        points = np.array([model.points3D[point.point3D_id].xyz for point in observed]).reshape(-1, 3)
        pose = image.cam_from_world().matrix()
        projected = camera.img_from_cam(points @ pose[:, :3].T + pose[:, 3])
        pixels = np.array([point.xy for point in observed]).reshape(-1, 2)
        missed_px = np.linalg.norm(projected - pixels, axis=1)  # not a number where nothing can be projected
        errors[image.name] = float(np.median(np.where(np.isfinite(missed_px), missed_px, np.inf))) if observed else np.inf
    return errors


def find_suspicious_images(model: pycolmap.Reconstruction, ratio: float) -> list[str]:
    """Names of the images whose median reprojection error is more than `ratio` times that of the median image."""
    errors = measure_reprojection_errors_px(model)
    limit = ratio * float(np.median(list(errors.values())))
    return [name for name, error in errors.items() if error > limit]


def remove_images(model: pycolmap.Reconstruction, names: list[str]) -> pycolmap.Reconstruction:
    """A copy of the model in which the images `names` have no pose."""
    copy = pycolmap.Reconstruction(model)
    for image_id in sorted(copy.reg_image_ids()):
        if copy.images[image_id].name in names:
            copy.deregister_frame(copy.images[image_id].frame_id)
    return copy


def refine_robustly(model: pycolmap.Reconstruction) -> None:
    """Bundle adjustment of all cameras and points under a Cauchy loss, in place.

    Least squares lets the few matches that are wrong by some pixels bend lens and poses: on the cracker box without a
    surface a camera ends 12 mm off, with the Cauchy loss 2 mm.
    """
    pycolmap.ObservationManager(model).filter_all_points3D(2 * STRICT_ERROR_PX, MIN_ANGLE_DEG)
    adjust_robustly(model, LOSS_SCALE_PX, ITERATIONS)
    pycolmap.ObservationManager(model).filter_all_points3D(STRICT_ERROR_PX, MIN_ANGLE_DEG)


def repair(
    model: pycolmap.Reconstruction, database: Path, images: Path, scratch: Path, seed: int, ratio: float = 1.5, rounds: int = 3
) -> tuple[pycolmap.Reconstruction, list[str]]:
    """Refine the model, place suspicious images again, and repeat while there are any.

    Returns:
        The model and the names of the images that were placed again.
    """
    refine_robustly(model)
    again: set[str] = set()
    for _ in range(rounds):
        doubtful = find_suspicious_images(model, ratio)
        if not doubtful or set(doubtful) <= again:
            break
        again |= set(doubtful)
        model = register_again(model, doubtful, database, images, scratch, seed)
        refine_robustly(model)
    return model, sorted(again)


def register_again(
    model: pycolmap.Reconstruction,
    names: list[str],
    database: Path,
    images: Path,
    scratch: Path,
    seed: int,
    known_lenses: bool = False,
) -> pycolmap.Reconstruction:
    """Take the images `names` out, refine the rest, then register what is missing under a strict error limit.

    Images that cannot be placed stay out. Lenses that are known stay as they are.
    """
    for folder in (scratch / "without", scratch / "again"):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    rest = remove_images(model, names)
    write_reconstruction(rest, scratch / "without")
    options = make_mapping_options(3, seed)
    options.multiple_models = False
    strict_px = STRICT_ERROR_PX * max(max(camera.width, camera.height) for camera in model.cameras.values()) / REFERENCE_PX
    options.mapper.abs_pose_max_error = strict_px
    if known_lenses:
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = False
    placed = pycolmap.incremental_mapping(database, images, scratch / "again", options, str(scratch / "without"))
    return max(placed.values(), key=lambda found: found.num_reg_images(), default=rest)
