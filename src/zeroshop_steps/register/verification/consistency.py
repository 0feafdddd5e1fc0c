"""Check a reconstruction against the masks and the matches of image pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import measure_turn_deg
from zeroshop_steps.register.mapping.reregistration import measure_reprojection_errors_px
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.lenses import folds
from zeroshop_steps.register.scene.record import Evidence, Fault, Finding, Inconsistent
from zeroshop_steps.register.scene.undistortion import undistort_masks
from zeroshop_steps.register.silhouettes.coherence import (
    UNEXPLAINED_PX,
    SilhouetteCoherence,
    find_doubtful_mask,
    find_wrong_masks,
    measure_silhouette_coherence,
    shrink_masks,
)
from zeroshop_steps.register.verification.epipolar_support import EpipolarSupport, count_epipolar_support
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY, SURFACE, WRONG, Verdict, judge

JUMP_DEG = 75.0
JUMP_RATIO = 3.0
"""Between neighbours, the camera turns by less than this angle, or less than this many times what it turns in the median: up to 61 degrees
in right models of 20 frames in two rounds, 94 and more in wrong ones."""
UNSURE_SHARE, UNSURE_POINTS = 0.3, 1 / 3
"""An image is held unsurely where this share of its matches contradicts the model, and it sees less than this share of the points that the
median image sees: four of twenty photos of a box that stood before a plain ground, with 0.34 to 0.53 and 51 to 76 points of 354, were 96 to
490 mm off. With masks, outlines tell."""


@dataclass(frozen=True)
class ConsistencyLimits:
    """What the figures of a model are measured by: where one is as large as its limit, its finding has the strength 1.

    Set on virtual captures of 32 objects: models on textured ground stay below (centres within 0.1 mm), and five models on other grounds
    that are consistent in themselves but wrong by 4 to 500 mm are above.

    Attributes:
        unexplained_px: mask rays of one view may miss the other masks by this much (95th percentile), per 1000 px of the longer side.
        contradicted_share: this share of an image's verified matches may contradict the model. A box with faces that look
            alike reaches 0.5 in a right model, an image on the wrong side of it 0.7.
        error_ratio: an image's median reprojection error may be this many times that of the median image, ...
        error_px: ... or this large.
        cut_matches: any two groups of images must be held together by this many matches.
        least_points: an image that sees fewer points tells nothing by its error, nor by the share of matches that contradict the model:
            for cameras that more than matches holds.
        rough_share: masks that are drawn by hand may miss by this share of the square root of their area, where the cameras were found
            without them; with outlines that waver by 1.5 % of it, rays miss by 4 %.
        wrong_masks_share: of the masks that may be wrong there, before the cameras are doubted instead.
        max_wrong_probability: cameras are refused that are wrong with this probability or a higher one.
    """

    unexplained_px: float = UNEXPLAINED_PX
    contradicted_share: float = 0.6
    error_ratio: float = 2.5
    error_px: float = 0.5
    cut_matches: int = 60
    least_points: int = 0
    rough_share: float = 0.06
    wrong_masks_share: float = 0.4
    max_wrong_probability: float = MAX_WRONG_PROBABILITY


@dataclass(frozen=True)
class ConsistencyReport:
    """The figures of all checks, and what speaks against the model.

    Attributes:
        coherence: of the masks; None where there are none.
        evidence: of the image pairs.
        errors_px: {image name: median reprojection error}.
        findings: what speaks against the model.
        fault: what no right model has, whatever else was found.
        wrong_masks: images whose masks contradict most of the others, and were left out of the check.
        max_wrong_probability: from where on the model is doubtful.
    """

    coherence: SilhouetteCoherence | None
    evidence: EpipolarSupport
    errors_px: dict[str, float]
    findings: tuple[Finding, ...] = ()
    fault: Fault | None = None
    wrong_masks: tuple[str, ...] = ()
    max_wrong_probability: float = MAX_WRONG_PROBABILITY

    @cached_property
    def verdict(self) -> Verdict:
        """How likely the model is wrong, by these figures alone."""
        return judge(self.findings)

    @property
    def is_doubtful(self) -> bool:
        """Whether the model is rather wrong."""
        return self.fault is not None or self._is_refused

    @property
    def culprits(self) -> tuple[str, ...]:
        """The images to blame where the findings make the model doubtful, if single ones are; a fault blames none."""
        return self.verdict.findings[0].images if self._is_refused else ()

    @property
    def _is_refused(self) -> bool:
        return self.verdict.wrong >= self.max_wrong_probability

    def gather(self) -> Evidence:
        """What the checks found, for the verdict."""
        return Evidence({"consistency": self.figures()}, self.findings, self.fault)

    def figures(self) -> dict[str, Any]:
        """The figures as written to registration.json; an error without bounds is None there."""
        cut, group = self.evidence.weakest_cut()
        worst = max(self.errors_px.values(), default=np.nan)
        silhouettes = {}
        if self.coherence:
            silhouettes = {
                "silhouette_px": dict(zip(self.coherence.names, np.round(self.coherence.unexplained_px, 2).tolist(), strict=True)),
                "silhouette_worst_px": round(float(self.coherence.unexplained_px.max()), 2),
            }
        if self.wrong_masks:
            silhouettes["wrong_masks"] = list(self.wrong_masks)
        return {
            **silhouettes,
            "error_px": {name: round(error, 3) if np.isfinite(error) else None for name, error in self.errors_px.items()},
            "error_worst_ratio": round(worst / float(np.median(list(self.errors_px.values()))), 2) if np.isfinite(worst) else None,
            "contradicted_share": dict(zip(self.evidence.names, np.round(self.evidence.contradicted_share, 3).tolist(), strict=True)),
            "contradicted_worst_share": round(float(self.evidence.contradicted_share.max(initial=0.0)), 3),
            "weakest_cut_matches": cut,
            "weakest_cut_images": list(group),
        }


def check_consistency(
    model: pycolmap.Reconstruction, image_set: ImageSet, database: Path, limits: ConsistencyLimits, doubt_masks: bool = False
) -> ConsistencyReport:
    """Check a model against the masks, if there are any, and against each image pair's own matches.

    Where the whole scene was registered, masks that contradict the others are more likely wrong than the cameras, which the ground
    holds: `doubt_masks` leaves them out, and allows for outlines drawn by hand.
    """
    coherence: SilhouetteCoherence | None = None
    wrong_masks: list[str] = []
    mask_limits = {name: limits.unexplained_px * scale for name, scale in image_set.scales.items()}
    if image_set.masks:
        whole, masks = undistort_masks(model, image_set)
        if doubt_masks:
            mask_limits |= {name: max(mask_limits[name], limits.rough_share * float(np.sqrt(mask.sum()))) for name, mask in masks.items()}
        cameras, masks = shrink_masks(whole, masks)
        factors = {one.name: one.width_px / small.width_px for one, small in zip(whole, cameras, strict=True)}
        small_limits = {name: mask_limits[name] / factor for name, factor in factors.items()}
        coherence = measure_silhouette_coherence(cameras, masks)
        if doubt_masks and _exceeds(coherence, small_limits).max() > 1:
            coherence, wrong_masks = _leave_out_wrong_masks(cameras, masks, coherence, small_limits, limits)
        coherence = coherence.enlarged(factors)
    evidence = count_epipolar_support(model, database)
    errors_px = measure_reprojection_errors_px(model)
    if limits.least_points:
        told = {image.name for image in model.images.values() if image.has_pose and image.num_points3D >= limits.least_points}
        evidence = evidence.take([name for name in evidence.names if name in told])
        errors_px = {name: error for name, error in errors_px.items() if name in told}
    findings = find_contradictions(coherence, evidence, errors_px, limits, image_set.scales, mask_limits)
    if image_set.film and (jump := find_jump(model, image_set.cuts)):
        findings = (*findings, jump)
    fault = None
    if any(folds(lens) for lens in model.cameras.values()):
        fault = Fault(
            f"{WRONG}: the distortion of its lens is not invertible, so the points constrain it too little; {SURFACE}", Inconsistent
        )
    return ConsistencyReport(coherence, evidence, errors_px, findings, fault, tuple(wrong_masks), limits.max_wrong_probability)


def find_unsure(model: pycolmap.Reconstruction, evidence: EpipolarSupport) -> list[str]:
    """Names of the images of a model that few points hold, while many matches contradict these."""
    seen = {image.name: image.num_points3D for image in model.images.values() if image.has_pose}
    least = UNSURE_POINTS * float(np.median(list(seen.values())))
    shares = zip(evidence.names, evidence.contradicted_share, strict=True)
    return [name for name, share in shares if share >= UNSURE_SHARE and seen[name] < least]


def _leave_out_wrong_masks(
    cameras: list[Camera],
    masks: dict[str, np.ndarray],
    coherence: SilhouetteCoherence,
    mask_limits_px: Mapping[str, float],
    limits: ConsistencyLimits,
) -> tuple[SilhouetteCoherence, list[str]]:
    """How well the masks agree without those that contradict most of the others, and the names of these; none if they were too many."""
    wrong = find_wrong_masks(cameras, masks, np.array([mask_limits_px[camera.name] for camera in cameras]))
    while len(wrong) <= limits.wrong_masks_share * len(cameras):
        kept = [camera for camera in cameras if camera.name not in wrong]
        left = measure_silhouette_coherence(kept, masks)
        if _exceeds(left, mask_limits_px).max() <= 1:
            return left, wrong
        wrong.append(find_doubtful_mask(kept, masks))
    return coherence, []


def _exceeds(coherence: SilhouetteCoherence, limits_px: Mapping[str, float]) -> np.ndarray:
    """(N,) by how many times its limit each view's rays miss the other masks."""
    return coherence.unexplained_px / [limits_px[name] for name in coherence.names]


def find_contradictions(
    coherence: SilhouetteCoherence | None,
    evidence: EpipolarSupport,
    errors_px: Mapping[str, float],
    limits: ConsistencyLimits,
    scales: Mapping[str, float],
    mask_limits_px: Mapping[str, float],
) -> tuple[Finding, ...]:
    """What silhouettes, matches and reprojection errors say against a model, each by its worst image.

    `scales` are those of `ImageSet`, `mask_limits_px` by how much the rays of each view may miss the other masks.
    """
    findings = []
    if coherence:
        excess = _exceeds(coherence, mask_limits_px)
        name, worst_px = coherence.names[int(excess.argmax())], float(coherence.unexplained_px[excess.argmax()])
        found = f"rays through the mask of {name} miss the other masks by {worst_px:.1f} px"
        findings.append(Finding("silhouettes", float(excess.max()), found, (coherence.culprit(),)))
    if not errors_px:
        return tuple(findings)
    share = evidence.contradicted_share
    name = evidence.names[int(share.argmax())]
    found = f"{share.max():.0%} of the matches of {name} contradict it (sides that look alike?)"
    findings.append(Finding("contradicted", float(share.max()) / limits.contradicted_share, found, (name,)))
    errors = {name: error_px / scales[name] for name, error_px in errors_px.items()}
    name = max(errors, key=errors.__getitem__)
    largest_px = max(limits.error_px, limits.error_ratio * float(np.median(list(errors.values()))))
    found = f"{name} fits with {errors_px[name]:.2f} px, the median image with {float(np.median(list(errors_px.values()))):.2f} px"
    if not np.isfinite(errors[name]):
        found = f"{name} sees no points of the model, or most of them lie behind it"
    findings.append(Finding("error", min(errors[name] / largest_px, 10.0) if np.isfinite(errors[name]) else 10.0, found, (name,)))
    matches, group = evidence.weakest_cut()
    found = f"{matches} matches hold {', '.join(group)} to the other images, at least {limits.cut_matches} are needed"
    found = f"only {found}" if matches < limits.cut_matches else found
    findings.append(Finding("cut", limits.cut_matches / max(matches, 1), found, group))
    return tuple(findings)


def find_jump(model: pycolmap.Reconstruction, cuts: Sequence[int] = ()) -> Finding | None:
    """Where the camera turns most between two neighbours; None where no two frames follow each other.

    Args:
        model: the cameras; its images are named by their place in the film, 000000.png and so on.
        cuts: places of the frames before which the film was cut: there, the camera may be anywhere.
    """
    images = sorted((model.images[image_id] for image_id in model.reg_image_ids()), key=lambda image: image.name)
    names = [image.name for image in images]
    rotations = [image.cam_from_world().rotation.matrix() for image in images]
    turns = np.array([measure_turn_deg(one, other) for one, other in zip(rotations, rotations[1:], strict=False)])
    places = np.array([int(Path(name).stem) for name in names])
    next_to = (np.diff(places) == 1) & ~np.isin(places[1:], cuts)
    if not next_to.any():
        return None
    limit_deg = max(JUMP_DEG, JUMP_RATIO * float(np.median(turns[next_to])))
    jumps = np.flatnonzero(next_to & (turns > limit_deg))
    worst = int(np.where(next_to, turns, 0.0).argmax())
    pair = f"{names[worst]} and {names[worst + 1]}, which follow each other in the film"
    found = f"between {pair}, the camera would turn by {turns[worst]:.0f} degrees"
    alone = [index + 1 for index in jumps[:-1] if index + 1 in jumps]
    return Finding("jump", float(turns[worst] / limit_deg), found, (names[alone[0]],) if alone else ())
