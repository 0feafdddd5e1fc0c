"""Average recall of the localization task: which instances were found at every threshold of every pose error.

As in the BOP Challenges since 2019: of an object's estimates in an image, the most confident ones count, as many as there are
instances to find, and of its instances as many of the most visible ones. In the order of their scores, each estimate is matched with
the nearest instance that is still free, if its error is below the threshold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.estimates import Estimates
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.bop.formats.pose_checks import make_transform
from zeroshop_steps.bop.formats.targets import Frames, Target
from zeroshop_steps.bop.scoring.depth_render import DepthPatch, DepthRenderer
from zeroshop_steps.bop.scoring.pose_error import VSD_TAUS, ModelPoints, mspd, mssd, vsd
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

THRESHOLDS = np.arange(0.05, 0.51, 0.05)
"""Of VSD, and of MSSD in diameters, as BOP defines them."""
THRESHOLDS_PX = np.arange(5.0, 51.0, 5.0)
"""Of MSPD in an image that is 640 px wide, as BOP defines them."""
ERRORS = ("vsd", "mssd", "mspd")


@dataclass(frozen=True)
class PosePairs:
    """Pairs of every estimate that counts with every instance of its target, target by target, estimates in order of their scores.

    Attributes:
        target: (P,) index of the target.
        estimate: (P,) row of the estimate.
        instance: (P,) index in the image's annotations.
        first: (T + 1,) index of each target's first pair.
        instances: (T,) number of instances of each target; its pairs are a table with a row per estimate and a column per instance.
    """

    target: np.ndarray
    estimate: np.ndarray
    instance: np.ndarray
    first: np.ndarray
    instances: np.ndarray


def pair_up(estimates: Estimates, targets: Sequence[Target], frames: Frames) -> PosePairs:
    """The pairs to compare. Raises StepError if visibility decides which instances count and scene_gt_info.json lacks it."""
    order = np.lexsort((np.arange(len(estimates)), -estimates.scores))
    rows: dict[tuple[int, int, int], list[int]] = {}
    for row in order:
        key = int(estimates.scene_ids[row]), int(estimates.image_ids[row]), int(estimates.object_ids[row])
        rows.setdefault(key, []).append(int(row))
    target_of, estimate_of, instance_of, first, counts = [], [], [], [0], []
    for index, target in enumerate(targets):
        chosen = rows.get((target.scene_id, target.im_id, target.obj_id), [])[: target.inst_count]
        instances = select_most_visible(frames[target.scene_id, target.im_id], target)
        for row in chosen:
            target_of += [index] * len(instances)
            estimate_of += [row] * len(instances)
            instance_of += instances
        first.append(len(target_of))
        counts.append(len(instances))
    return PosePairs(*(np.array(values, np.int64) for values in (target_of, estimate_of, instance_of, first, counts)))


def select_most_visible(frame: Frame, target: Target) -> list[int]:
    """The `inst_count` most visible instances of a target's object, in the order of the annotations."""
    found = [index for index, instance in enumerate(frame.instances) if instance.object_id == target.obj_id]
    if len(found) == target.inst_count:
        return found
    visible = {index: share for index in found if (share := frame.instances[index].visible_share) is not None}
    if len(visible) < len(found):
        raise StepError(
            f"{frame.folder / 'scene_gt_info.json'} has no visib_fract for object {target.obj_id} of image {frame.image_id};"
            f" it decides which {target.inst_count} of {len(found)} instances count"
        )
    best = sorted(found, key=lambda index: -visible[index])[: target.inst_count]
    return sorted(best)


def measure_pose_errors(
    pairs: PosePairs,
    estimates: Estimates,
    targets: Sequence[Target],
    frames: Frames,
    models: dict[int, ObjectModel],
    kinds: Sequence[str],
    width_px: int | None,
    delta_mm: float,
) -> dict[str, np.ndarray]:
    """The errors of all pairs.

    Returns:
        those in `kinds`: `mssd` (P, 1) in diameters, `mspd` (P, 1) in px of an image 640 px wide, `vsd` (P, 10) with a column per
        tolerance.
    """
    estimated = make_transform(estimates.rotations, estimates.translations_mm)[pairs.estimate]
    frame_of = [frames[targets[index].scene_id, targets[index].im_id] for index in pairs.target]
    true = np.array([frame.instances[i].camera_from_model for frame, i in zip(frame_of, pairs.instance, strict=True)]).reshape(-1, 4, 4)
    intrinsics = np.array([frame.intrinsics for frame in frame_of]).reshape(-1, 3, 3)
    objects = np.array([targets[index].obj_id for index in pairs.target], np.int64)
    errors = {kind: np.full((len(objects), len(VSD_TAUS) if kind == "vsd" else 1), np.inf) for kind in kinds}
    for object_id in np.unique(objects):
        model, of_object = models[int(object_id)], objects == object_id
        points = ModelPoints.from_vertices(model.mesh.vertices)
        if "mssd" in kinds:
            errors["mssd"][of_object, 0] = mssd(estimated[of_object], true[of_object], points, model.symmetries) / model.scored_diameter_mm
        if "mspd" in kinds:
            found_px = mspd(estimated[of_object], true[of_object], intrinsics[of_object], points, model.symmetries)
            widths = np.array([_width_px(frame_of[index], width_px) for index in np.flatnonzero(of_object)])
            # The thresholds of MSPD are meant for images of this width.
            errors["mspd"][of_object, 0] = found_px * 640.0 / widths
    if "vsd" in kinds:
        errors["vsd"] = _measure_vsd(pairs, estimated, true, frame_of, objects, models, delta_mm)
    return errors


def _measure_vsd(
    pairs: PosePairs,
    estimated: np.ndarray,
    true: np.ndarray,
    frame_of: Sequence[Frame],
    objects: np.ndarray,
    models: dict[int, ObjectModel],
    delta_mm: float,
) -> np.ndarray:
    """(P, 10) VSD, image by image. The measured depth is read once, and each pose is rendered once however many pairs it is in."""
    errors = np.ones((len(objects), len(VSD_TAUS)))
    renderers = {int(object_id): DepthRenderer(models[int(object_id)].mesh) for object_id in np.unique(objects)}
    images: dict[tuple[int, int], list[int]] = {}
    for index, frame in enumerate(frame_of):
        images.setdefault((frame.scene_id, frame.image_id), []).append(index)
    for members in track(images.values(), "visible surface", len(images)):
        frame = frame_of[members[0]]
        measured = frame.depth_mm()
        height, width = measured.shape
        rendered: dict[tuple[str, int], DepthPatch] = {}
        for index in members:
            object_id = int(objects[index])
            poses = {("estimate", int(pairs.estimate[index])): estimated[index], ("instance", int(pairs.instance[index])): true[index]}
            for key, pose in poses.items():
                if key not in rendered:
                    rendered[key] = renderers[object_id].render(pose, frame.intrinsics, width, height)
            here, there = (rendered[key] for key in poses)
            errors[index] = vsd(measured, here, there, frame.intrinsics, models[object_id].scored_diameter_mm, delta_mm)
    return errors


def _width_px(frame: Frame, width_px: int | None) -> float:
    if width_px is None:
        raise StepError(f"{frame.folder} has no pictures and so no image width, which MSPD is relative to; give --image-width")
    return float(width_px)


def count_found_instances(pairs: PosePairs, errors: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """(T, D) number of found instances of each of T targets at each of D thresholds, from (P,) errors."""
    return _match_instances(pairs.first, pairs.instances, np.ascontiguousarray(errors), thresholds)


@numba.njit(cache=True)
def _match_instances(first: np.ndarray, instances: np.ndarray, errors: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """`count_found_instances`; `first` and `instances` as in `PosePairs`."""
    found = np.zeros((len(instances), len(thresholds)), np.int64)
    for target in range(len(instances)):
        columns = instances[target]
        if columns == 0:
            continue
        rows = (first[target + 1] - first[target]) // columns
        for index in range(len(thresholds)):
            taken = np.zeros(columns, np.bool_)
            for row in range(rows):
                best, nearest = -1, thresholds[index]
                for column in range(columns):
                    error = errors[first[target] + row * columns + column]
                    if not taken[column] and error < nearest:
                        best, nearest = column, error
                if best >= 0:
                    taken[best] = True
                    found[target, index] += 1
    return found


@dataclass(frozen=True)
class AverageRecall:
    """Average recalls over the thresholds.

    Attributes:
        overall: of each error, and `ar`, their mean, if all three are there.
        by_object: the same for each object.
        targets: number of instances to find, for each object.
    """

    overall: dict[str, float]
    by_object: dict[int, dict[str, float]]
    targets: dict[int, int]


def average_recall(pairs: PosePairs, errors: dict[str, np.ndarray], targets: Sequence[Target]) -> AverageRecall:
    """AR of each error and their mean, AR_D: the share of found instances, averaged over thresholds (and tolerances of VSD)."""
    objects = np.array([target.obj_id for target in targets])
    shares: dict[str, np.ndarray] = {}
    for kind, values in errors.items():
        thresholds = THRESHOLDS_PX if kind == "mspd" else THRESHOLDS
        shares[kind] = np.mean([count_found_instances(pairs, column, thresholds).mean(1) for column in values.T], axis=0)

    def summed(chosen: np.ndarray) -> dict[str, float]:
        count = pairs.instances[chosen].sum()
        means = {f"ar_{kind}": float(share[chosen].sum() / count) for kind, share in shares.items()}
        return ({"ar": float(np.mean(list(means.values())))} if set(shares) == set(ERRORS) else {}) | means

    by_object = {int(number): summed(objects == number) for number in np.unique(objects)}
    counts = {int(number): int(pairs.instances[objects == number].sum()) for number in np.unique(objects)}
    return AverageRecall(summed(np.ones(len(objects), bool)), by_object, counts)
