"""Improve a model that passed all checks: by its points' pictures, and by the masks' rims."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import pycolmap

from zeroshop_steps.register.mapping.reregistration import remove_images
from zeroshop_steps.register.refinement.keypoint_refinement import refine_keypoints
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_silhouettes
from zeroshop_steps.register.silhouettes.state import TrackKind
from zeroshop_steps.register.verification.consistency import ConsistencyReport

ROUGH_MISS_PX = 0.5
"""Rims that miss by more in the mean, per 1000 px, are too rough to adjust by. Renderer's masks: 0.05 to 0.2; a network's in 43 photos
of a mug on a wooden table 0.31, where they brought the cameras from 3.1 to 1.6 mm."""


Entries = dict[str, Any]
"""Of registration.json."""
Change = Callable[[pycolmap.Reconstruction], tuple[pycolmap.Reconstruction, Entries]]


@dataclass(frozen=True)
class Hypothesis:
    """Cameras and points that explain the matches, and what the checks say of them.

    Attributes:
        model: the cameras, with their lenses' distortion, and the points.
        report: of the checks against masks and image pairs.
        placed_again, left_out: images that were registered a second time, and those that were left out.
        merged: whether it was put together from submodels, which no matches hold to each other.
    """

    model: pycolmap.Reconstruction
    report: ConsistencyReport
    placed_again: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    merged: bool = False

    @property
    def registered(self) -> int:
        """How many images have a camera."""
        return int(self.model.num_reg_images())


@dataclass(frozen=True)
class Improver:
    """Changes a model that passed all checks; it stays as it was where it would not pass any more.

    Attributes:
        image_set: of the registration.
        check: of a model against masks and image pairs.
        needed: images that must stay. Those that contradict the changed model alone are left out: the others had been bent to them.
    """

    image_set: ImageSet
    check: Callable[[pycolmap.Reconstruction], ConsistencyReport]
    needed: int

    def refine_keypoints(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Entries]:
        """Bring the points into line by the pictures; with the record's entries."""
        images = {path.name: path for path in self.image_set.images}

        def change(model: pycolmap.Reconstruction) -> tuple[pycolmap.Reconstruction, Entries]:
            refined, figures = refine_keypoints(model, images)
            return refined, {"sharpened": figures}

        return self._try(change, hypothesis)

    def adjust_by_silhouettes(self, hypothesis: Hypothesis, aligned: bool) -> tuple[Hypothesis, Entries]:
        """Adjust the cameras by the masks' rims, unless these are rough; with the record's entries.

        `aligned`: whether pictures have aligned points; these count by their noise.
        """
        wrong_masks = hypothesis.report.wrong_masks

        def change(model: pycolmap.Reconstruction, kind: TrackKind) -> tuple[pycolmap.Reconstruction, Entries]:
            adjusted, entries = adjust_model_by_silhouettes(model, self.image_set, wrong_masks, kind), Entries()
            doubtful = adjusted.standing_out if self.image_set.masks_found else []
            if doubtful and model.num_reg_images() - len(doubtful) >= self.needed:
                adjusted = adjust_model_by_silhouettes(remove_images(model, doubtful), self.image_set, wrong_masks, kind)
                entries = {"standing_out": doubtful}
            return adjusted.model if adjusted.missed_px[1] <= ROUGH_MISS_PX else model, entries | {"miss_px": list(adjusted.missed_px)}

        entries = Entries()
        for kind in (*([TrackKind.ALIGNED] if aligned else []), TrackKind.MATCHED):
            # Where what fits better lets one image stand out, all count alike.
            changed, found = self._try(partial(change, kind=kind), hypothesis)
            entries |= found
            if changed.model is not hypothesis.model:
                break
        return changed, {"outlines": entries | {"adjusted": changed.model is not hypothesis.model}}

    def _try(self, change: Change, hypothesis: Hypothesis) -> tuple[Hypothesis, Entries]:
        changed, entries = change(hypothesis.model)
        again, left_out = self.check(changed), hypothesis.left_out
        culprits = again.culprits
        if culprits and hypothesis.registered - len(culprits) >= self.needed:
            changed, more = change(remove_images(hypothesis.model, list(culprits)))
            again, left_out, entries = self.check(changed), (*left_out, *culprits), entries | more
        return hypothesis if again.is_doubtful else replace(hypothesis, model=changed, report=again, left_out=left_out), entries
