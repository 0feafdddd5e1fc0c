"""Triangulate what given cameras see, and adjust them to the pictures, held by what was stated of them.

Places are priors of the bundle adjustment, with the stated standard deviation along each axis; turns are held by the pictures, and by the
stated pose where hardly any point is seen. Where no deviation is stated, the pictures alone decide, and the cameras as a whole are laid
back onto those that were given, whose metres so stay the unit.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.capture.cameras_json import GivenCameras
from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_DEVIATIONS
from zeroshop_steps.geometry.cameras.pinhole import LEAST_PAIRS, find_centre, fit_similarity_robustly, to_matrix
from zeroshop_steps.geometry.cameras.transforms import measure_turn_deg
from zeroshop_steps.register.mapping.mapper import make_adjustment_options, triangulate_points
from zeroshop_steps.register.mapping.reregistration import ITERATIONS, LOSS_SCALE_PX, STRICT_ERROR_PX
from zeroshop_steps.register.scene.image_set import ImageSet

ROUGH_ERROR_PX, ROUGH_ANGLE_DEG = 30.0, 3.0
"""By which observations may miss a point before the cameras are adjusted: 0.3 degrees are 5 px at 1000 px of focal length."""
LEAST_POINTS = 15  # seen by an image, for the pictures to turn its camera


@dataclass(frozen=True)
class Shifts:
    """By how much the pictures moved each camera. Names of N images, and (N,) arrays.

    Attributes:
        names: of the images.
        position_m, rotation_deg: lengths of the shifts.
        position_sigmas, rotation_sigmas: root mean square over the axes, in stated deviations; None where none are stated.
    """

    names: tuple[str, ...]
    position_m: np.ndarray
    rotation_deg: np.ndarray
    position_sigmas: np.ndarray | None
    rotation_sigmas: np.ndarray | None

    def figures(self) -> dict[str, Any]:
        """As written to registration.json."""
        entries: dict[str, Any] = {
            "shift_mm": dict(zip(self.names, np.round(1000 * self.position_m, 3).tolist(), strict=True)),
            "turn_deg": dict(zip(self.names, np.round(self.rotation_deg, 4).tolist(), strict=True)),
        }
        for key, values in (("shift_sigmas", self.position_sigmas), ("turn_sigmas", self.rotation_sigmas)):
            if values is not None:
                entries[key] = {"mean_square_root": round(float(np.sqrt((values**2).mean())), 2), "largest": round(float(values.max()), 2)}
        return entries

    def warnings(self, shown: Mapping[str, str]) -> list[str]:
        """What the user should know: cameras that lie farther off than what was stated of them allows."""
        found = []
        for values, what in ((self.position_sigmas, "places"), (self.rotation_sigmas, "turns")):
            if values is None:
                continue
            whole = float(np.sqrt((values**2).mean()))
            far = [shown[name] for name, sigmas in zip(self.names, values, strict=True) if sigmas > AGREEING_DEVIATIONS]
            if whole > AGREEING_DEVIATIONS:
                found.append(
                    f"the pictures move the given {what} by {whole:.1f} times the stated deviation: they are noisier than stated, and"
                    " the pictures were believed"
                )
            elif far:
                found.append(f"the pictures move the given {what} of {len(far)} images by more than 3 stated deviations: {', '.join(far)}")
        return found


def triangulate(
    database: Path, image_set: ImageSet, poses: Mapping[str, pycolmap.Rigid3d], seed: int, rough: bool
) -> pycolmap.Reconstruction:
    """Sparse points from the matches of a database, cameras held fixed; `rough` where they may be off by some pixels.

    Args:
        poses: {image name: camera_from_world}; images without one are left out.
    """
    scale = max(image_set.scales.values())
    error_px = (ROUGH_ERROR_PX if rough else STRICT_ERROR_PX) * scale

    def loosen(options: pycolmap.IncrementalPipelineOptions) -> None:
        options.mapper.filter_max_reproj_error = error_px
        options.triangulation.merge_max_reproj_error = options.triangulation.complete_max_reproj_error = error_px
        if rough:  # once is enough: the points are found anew for the adjusted cameras
            options.ba_global_max_refinements = 1
            options.triangulation.create_max_angle_error = options.triangulation.continue_max_angle_error = ROUGH_ANGLE_DEG

    return triangulate_points(database, image_set, {Path(name).stem: pose for name, pose in poses.items()}, seed, loosen)


def take_poses(model: pycolmap.Reconstruction) -> dict[str, pycolmap.Rigid3d]:
    """{image name: camera_from_world} of a model."""
    return {image.name: image.cam_from_world() for image in model.images.values() if image.has_pose}


def adjust(model: pycolmap.Reconstruction, given: GivenCameras, scale_px: float = LOSS_SCALE_PX) -> None:
    """Bundle adjustment under a Cauchy loss, with the given places as priors or, without stated deviations, as the frame; in place.

    Lenses stay as they were given. An image with fewer than `LEAST_POINTS` points keeps its pose.
    """
    options = make_adjustment_options(scale_px, ITERATIONS)
    options.refine_focal_length = options.refine_extra_params = False
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(model.reg_image_ids()):
        config.add_image(image_id)
        if model.images[image_id].num_points3D < LEAST_POINTS:
            config.set_constant_rig_from_world_pose(model.images[image_id].frame_id)
    if len(config.constant_rig_from_world_poses) == model.num_reg_images():
        return
    if given.position_deviation_m is None:
        if len(config.constant_rig_from_world_poses) < 2:
            config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        pycolmap.create_default_bundle_adjuster(options, config, model).solve()
        align(model, given)
        return
    poses, priors = given.poses, []
    # The loss takes an observation's error for pixels, of which it has as many as the loss's scale; priors count by the same unit.
    covariance = np.eye(3) * (given.position_deviation_m / scale_px) ** 2
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        if image.name in poses:
            prior = pycolmap.PosePrior(
                position=find_centre(poses[image.name]),
                position_covariance=covariance,
                coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
                corr_data_id=image.data_id,
            )
            priors.append(prior)
    prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
    prior_options.alignment_ransac.random_seed = 0
    # A single pose that is wrong does not drag the others along.
    prior_options.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
    prior_options.ceres.prior_position_loss_scale = AGREEING_DEVIATIONS * scale_px
    pycolmap.create_pose_prior_bundle_adjuster(options, prior_options, config, priors, model).solve()


def align(model: pycolmap.Reconstruction, given: GivenCameras) -> None:
    """Lay a model onto the given cameras by a similarity, in place; single ones that are far off do not count."""
    pairs = [
        (find_centre(to_matrix(pose)), find_centre(given.poses[name])) for name, pose in take_poses(model).items() if name in given.poses
    ]
    if len(pairs) < LEAST_PAIRS:
        return
    similarity, _ = fit_similarity_robustly(*(np.array(side) for side in zip(*pairs, strict=True)))
    model.transform(pycolmap.Sim3d(similarity[:3]))


def measure_shifts(model: pycolmap.Reconstruction, given: GivenCameras) -> Shifts:
    """How far the cameras of a model lie from the given ones."""
    stated, poses = given.poses, take_poses(model)
    names = tuple(sorted(name for name in poses if name in stated))
    found = [to_matrix(poses[name]) for name in names]
    moved = np.array([find_centre(pose) - find_centre(stated[name]) for name, pose in zip(names, found, strict=True)]).reshape(-1, 3)
    turned = np.array([measure_turn_deg(stated[name][:3, :3], pose[:3, :3]) for name, pose in zip(names, found, strict=True)])
    length = np.linalg.norm(moved, axis=1)
    by_place = length / (np.sqrt(3) * given.position_deviation_m) if given.position_deviation_m else None
    by_turn = turned / (np.sqrt(3) * given.rotation_deviation_deg) if given.rotation_deviation_deg else None
    return Shifts(names, length, turned, by_place, by_turn)
