"""Register an object by its outlines alone, where it has too few features: the last attempt of `auto`.

Masks must be exact and whole. All views are placed by a beam search (`pose_search`), above the object's middle, and where they do not
fit there, anywhere around it. They are adjusted by all outlines, and judged: the rays must meet all masks, and few views may fit anywhere
else; these are left out. So objects of revolution, and others whose outlines say no side, are refused.
SIFT's matches on the object, triangulated from these cameras, then hold them, too, and may contradict them. Last, corners that are found
along the visual hull do (`guided_matching`).
"""

import math
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera, to_rigid
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.register.features.sift import SiftOptions, extract_features
from zeroshop_steps.register.mapping.mapper import triangulate_points
from zeroshop_steps.register.matching.verified_matches import match_features
from zeroshop_steps.register.pipeline import WRONG_MASKS_OF_OBJECT, StructureOptions
from zeroshop_steps.register.refinement.guided_matching import adjust_by_guided_tracks
from zeroshop_steps.register.scene.image_set import ImageSet, read_masks
from zeroshop_steps.register.scene.lenses import import_images
from zeroshop_steps.register.scene.record import Record, RegistrationFailed, Stopwatch, describe_model, find_missing
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_silhouettes
from zeroshop_steps.register.silhouettes.pose_alternatives import find_alternatives, mirror, replace_worst
from zeroshop_steps.register.silhouettes.pose_fit import SilhouetteFit, adjust, describe_fit
from zeroshop_steps.register.silhouettes.pose_search import (
    ABOVE_DEG,
    ANYWHERE_DEG,
    HOPELESS_PX,
    PoseHypothesis,
    count_differing,
    make_cameras,
    prepare_outlines,
    read_hypothesis,
    search,
    take_outlines,
)
from zeroshop_steps.register.silhouettes.view_poses import Outlines
from zeroshop_steps.register.verification.epipolar_support import count_epipolar_support
from zeroshop_steps.register.verification.photometric_consistency import check_photometric_consistency
from zeroshop_steps.register.verification.verdict import verify
from zeroshop_steps.runtime.files import scratch_directory

ATTEMPTS = (ABOVE_DEG, ABOVE_DEG, ANYWHERE_DEG, ANYWHERE_DEG)
"""Elevations at which views are placed, each time in another order: one that begins with views that say little may fail. Fewer places are
searched faster and fit by chance less often."""
LIKELY_PX = 2.0  # of a way that is adjusted: how far rays miss in the mean, coarsely
ELSEWHERE_PX = 1.0
"""A view that misses by less elsewhere could stand there, too. In 21 wrong placements of 13 objects, of 20 views each or of 14, more views
do than may be left out: three at least, eight in the median. With 1.5 it was not safer (three at least), but a foam brick was refused,
though its cameras are right: when one view is left out, the others are held less.
"""
FEW_MATCHES, MOST_CONTRADICTING = 60, 0.5
"""Of the pictures' verified matches, so many, or this share, may contradict the cameras: plain surfaces match in wrong places, too."""
RIVAL_PX, RIVAL_VIEWS = 0.3, 3  # a way that misses by hardly more, and places so many views elsewhere, is another
SURFACE = "put the object on a strongly textured surface"
UPRIGHT = "the cameras were taken to be held upright, at about one distance, and at most 65 degrees above or below the object's middle"


@dataclass(frozen=True)
class SilhouetteOptions:
    """Parameters: of the features that are triangulated at last, and what the result must fulfil."""

    sift: SiftOptions = field(default_factory=SiftOptions)
    structure: StructureOptions = field(default_factory=StructureOptions)


def register(image_set: ImageSet, out: Path, options: SilhouetteOptions) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and masks/ to `out`; returns the record.

    Raises:
        RegistrationFailed: outlines are cut off, do not fit together, or fit in several ways; or matches contradict the cameras.
        StepError: there are no masks.
    """
    count = len(image_set.images)
    record = Record.begin("outlines", image_set, options, pycolmap)
    by_name = read_masks(image_set)
    masks = [by_name[name] for name in image_set.names]
    cut = [image_set.shown[name] for name, mask in by_name.items() if _is_cut(mask)]
    if cut:
        raise record.fail(f"outlines cannot place the photos: the object is cut off in {len(cut)}, such as {cut[0]}")
    if count < options.structure.min_images:
        raise record.fail(f"outlines cannot place {count} photos: at least {options.structure.min_images} are needed")
    with scratch_directory(out, "outlines") as scratch:
        focal_px = _guess_focal_px(scratch / "lenses.db", image_set, options.sift.focal_px)
        views = _Views(image_set, by_name, prepare_outlines(masks, focal_px), focal_px)
        try:
            cameras, found = _find_cameras(views, options.structure, record.stopwatch)
        except RegistrationFailed as failure:
            raise failure.after(record) from None
        record = record.add(outlines=dict(found.entries))
        record.stopwatch.lap("elsewhere")
        whole, placed = image_set, {camera.name for camera in cameras}
        image_set = whole.take([number for number, name in enumerate(whole.names) if name in placed])
        database = scratch / "database.db"
        known = {Path(camera.name).stem: _make_lens(camera) for camera in cameras}
        extract_features(database, image_set, options.sift, scratch / "masks", known)
        match_features(database, options.sift)
        poses = {Path(camera.name).stem: to_rigid(camera.camera_from_world) for camera in cameras}
        model = triangulate_points(database, image_set, poses, options.sift.seed)
        record.stopwatch.lap("triangulate")
        joint = adjust_model_by_silhouettes(model, image_set)
        record.stopwatch.lap("outlines")
        model, guided = adjust_by_guided_tracks(joint.model, image_set)
        record = record.add(joint_miss_px=list(joint.missed_px), guided=guided)
        record.stopwatch.lap("guide")
        evidence = count_epipolar_support(model, database)
        pinhole_model, lenses = undistort(model, image_set, out)
        record.stopwatch.lap("undistort")
    record = record.judge(find_missing(whole, placed)).judge(lenses).add(**describe_model(pinhole_model))
    supporting, contradicting = int(evidence.supporting.sum()) // 2, int(evidence.contradicting.sum()) // 2
    record = record.add(matches={"supporting": supporting, "contradicting": contradicting})
    record.stopwatch.stop()
    if contradicting > max(FEW_MATCHES, MOST_CONTRADICTING * (supporting + contradicting)):
        reason = f"the outlines fit, but {contradicting} of {supporting + contradicting} matches of the pictures contradict the cameras"
        raise record.fail(f"{reason}; {SURFACE}", pinhole_model)
    check = partial(check_photometric_consistency, read_views(out)[0], wide=False)
    return dict(verify(record, [check], pinhole_model, options.structure.limits.max_wrong_probability).entries)


@dataclass(frozen=True)
class _Views:
    """N views to place: images, the masks of these and more by their names, outlines, and (N,) guesses of the focal lengths."""

    image_set: ImageSet
    masks: dict[str, np.ndarray]
    outlines: Outlines
    focal_px: np.ndarray

    def take(self, numbers: np.ndarray) -> "_Views":
        return _Views(self.image_set.take(numbers.tolist()), self.masks, take_outlines(self.outlines, numbers), self.focal_px[numbers])


def _find_cameras(views: _Views, options: StructureOptions, stopwatch: Stopwatch) -> tuple[list[Camera], Record]:
    """The cameras that outlines place in one way, adjusted by them, and what is known of that.

    `WRONG_MASKS_OF_OBJECT` of the views at most are left out: those that fit to the others nowhere, and, where too few fit once adjusted,
    the one that contradicts the others most first. Their masks are wrong, and bend the others' cameras.

    Raises:
        RegistrationFailed: too few are placed, or they do not fit.
    """
    known = Record()
    rng = np.random.default_rng(options.seed)
    best_px, adjusted_px, most_fitting = np.inf, list[tuple[float, float]](), 0
    count = len(views.image_set.images)
    needed, most_wrong = max(options.min_images, math.ceil(options.min_share * count)), int(WRONG_MASKS_OF_OBJECT * count)
    for elevations_deg in ATTEMPTS:
        ways, placed = search(views.outlines, rng.permutation(count).tolist(), elevations_deg, most_wrong)
        seen = views.take(placed)
        way, *others = [way.take(placed) for way in ways]
        if elevations_deg == ANYWHERE_DEG and way.cost < HOPELESS_PX:
            way, *others = _replace_worst(way, others, seen.outlines)
        stopwatch.lap("search")
        best_px = min(best_px, way.cost)
        known = Record({"elevations_deg": elevations_deg, "search_px": round(best_px, 2)})
        if way.cost > LIKELY_PX:
            continue
        misfits = sorted(set(views.image_set.names) - set(seen.image_set.names))
        fit = adjust(make_cameras(way, seen.outlines, seen.image_set, seen.focal_px), np.arange(len(placed)), views.masks)
        stopwatch.lap("adjust")
        adjusted_px.append((fit.miss_px, fit.worst_px))
        ambiguous, left_out = None, dict[str, float]()
        while True:
            fitting = fit.find_fitting()
            known = known.add(miss_px=round(fit.miss_px, 3), worst_view_px=round(fit.worst_px, 3), misfits=misfits, wrong_px=dict(left_out))
            if fit.is_fine and fitting.sum() >= needed:
                try:
                    return _place(fit, seen, elevations_deg, [way, *others], needed, known)
                except _SeveralWays as error:
                    if fitting.all():
                        raise _fail(str(error), Record(error.figures)) from None
                    ambiguous, known = error, Record(error.figures)
            most_fitting = max(most_fitting, int(fitting.sum()) if fit.is_fine else 0)
            if fitting.all() or len(misfits) + len(left_out) >= most_wrong:
                break
            fit, name, contradiction_px = fit.leave_out_worst(views.masks)
            left_out[name] = round(contradiction_px, 3)
        if ambiguous:
            raise _fail(str(ambiguous), known)
    told = f"those of {most_fitting} of {count} photos do, {needed} are needed"
    raise _fail(
        f"the outlines of the masks do not fit together ({told if most_fitting else describe_fit(best_px, adjusted_px)}); {UPRIGHT}, and"
        " masks must be exact",
        known,
    )


def _fail(reason: str, known: Record) -> RegistrationFailed:
    """The failure with what is known of the search, if it began."""
    return RegistrationFailed(reason, {"outlines": dict(known.entries)} if known.entries else {})


def _replace_worst(way: PoseHypothesis, others: list[PoseHypothesis], outlines: Outlines) -> list[PoseHypothesis]:
    """The best of all ways, and the others that are left, with the views mended that fit anywhere around the object better.

    Ways that are found share mistakes, and most of them are one when these are mended; what is no rival need not be.
    """
    way = replace_worst(way, outlines, ANYWHERE_DEG)
    if way.cost > LIKELY_PX:
        return [way]
    others = [replace_worst(other, outlines, ANYWHERE_DEG) if _is_rival(way, other) else other for other in others]
    return sorted([way, mirror(way, outlines), *others], key=lambda way: way.cost)


class _SeveralWays(RegistrationFailed):
    """Too few views fit in one way alone."""


def _place(
    fit: SilhouetteFit, views: _Views, elevations_deg: tuple[int, int], ways: list[PoseHypothesis], needed: int, known: Record
) -> tuple[list[Camera], Record]:
    """The cameras whose views fit, and nowhere else, adjusted by each other. Raises _SeveralWays where these are fewer than `needed`."""
    shown, fitting = views.take(fit.numbers), fit.find_fitting()
    by_name = zip(shown.image_set.names, fit.by_view_px, fitting, strict=True)
    known = known.add(stand_out_px={name: round(float(px), 3) for name, px, fits in by_name if not fits})
    found = read_hypothesis(fit.cameras, shown.outlines, shown.focal_px)
    kept, known = _keep_placed(shown, found, np.flatnonzero(fitting), elevations_deg, needed, known)
    way, *others = [way.take(fit.numbers[kept]) for way in ways]
    rivals = [other for other in others if _is_rival(way, other)]
    if rivals:
        raise _fail(f"the outlines fit in {1 + len(rivals)} ways; {SURFACE}", known)
    return (fit.cameras if len(kept) == len(fit.cameras) else fit.take(kept, views.masks).cameras), known


def _keep_placed(
    views: _Views, way: PoseHypothesis, kept: np.ndarray, elevations_deg: tuple[int, int], needed: int, known: Record
) -> tuple[np.ndarray, Record]:
    """(K,) numbers of the views that fit nowhere else, of those in `kept`. Raises _SeveralWays where fewer than `needed` are left.

    What held the others may go with a view that is left out, so all are asked again.
    """
    image_set, left_out = views.image_set, dict[str, float]()
    unfit = len(image_set.names) - len(kept)
    while True:
        elsewhere = find_alternatives(way.take(kept), take_outlines(views.outlines, kept), elevations_deg)
        names = [image_set.names[number] for number in kept]
        known = known.add(elsewhere_px=dict(zip(names, elsewhere.round(1).tolist(), strict=True)) | left_out)
        free = elsewhere < ELSEWHERE_PX
        if not free.any():
            return kept, known
        left_out |= {name: round(float(px), 1) for name, px, is_free in zip(names, elsewhere, free, strict=True) if is_free}
        kept = kept[~free]
        if len(kept) < needed:
            told = f"{len(left_out)} of {len(image_set.names)} photos, such as {image_set.shown[next(iter(left_out))]}"
            told += ", could have been taken from elsewhere" + (f", and {unfit} do not fit the others" if unfit else "")
            raise known.fail(f"the outlines fit in several ways: {told}; {SURFACE}", kind=_SeveralWays)


def _is_rival(found: PoseHypothesis, other: PoseHypothesis) -> bool:
    return other.cost < found.cost + RIVAL_PX and count_differing(found, other) >= RIVAL_VIEWS


def _make_lens(camera: Camera) -> pycolmap.Camera:
    params = [camera.intrinsics[0, 0], camera.intrinsics[0, 2], camera.intrinsics[1, 2]]
    return pycolmap.Camera(model="SIMPLE_PINHOLE", width=camera.width_px, height=camera.height_px, params=params)


def _guess_focal_px(database: Path, image_set: ImageSet, focal_px: float | None) -> np.ndarray:
    """(N,) focal lengths to start from: known, from EXIF, or guessed from the images' sizes."""
    import_images(database, image_set, focal_px, distorted=False)
    with pycolmap.Database.open(database) as opened:
        lenses = {camera.camera_id: camera.mean_focal_length() for camera in opened.read_all_cameras()}
        by_name = {image.name: lenses[image.camera_id] for image in opened.read_all_images()}
    return np.array([by_name[name] for name in image_set.names])


def _is_cut(mask: np.ndarray) -> bool:
    return bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
