"""Improve a model that passed all checks: by its points' pictures, and by the masks' rims."""

from collections.abc import Callable
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Improver:
    """Changes a model that passed all checks; it stays as it was where it would not pass any more.

    Attributes:
        image_set: of the registration.
        check: of a model against masks and image pairs.
        needed: images that must stay. Those that contradict the changed model alone are left out: the others had been bent to them.
        figures: the record; completed in place.
    """

    image_set: ImageSet
    check: Callable[[pycolmap.Reconstruction], ConsistencyReport]
    needed: int
    figures: dict[str, Any]

    def refine_keypoints(
        self, model: pycolmap.Reconstruction, report: ConsistencyReport
    ) -> tuple[pycolmap.Reconstruction, ConsistencyReport]:
        """Bring the points into line by the pictures."""
        images = {path.name: path for path in self.image_set.images}

        def change(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
            sharpened, self.figures["sharpened"] = refine_keypoints(model, images)
            return sharpened

        return self._try(change, model, report)

    def adjust_by_silhouettes(
        self, model: pycolmap.Reconstruction, report: ConsistencyReport
    ) -> tuple[pycolmap.Reconstruction, ConsistencyReport]:
        """Adjust the cameras by the masks' rims, unless these are rough; points that the pictures aligned count by their noise."""

        def change(model: pycolmap.Reconstruction, kind: TrackKind) -> pycolmap.Reconstruction:
            adjusted = adjust_model_by_silhouettes(model, self.image_set, report.wrong_masks, kind)
            doubtful = adjusted.standing_out if self.image_set.masks_found else []
            if doubtful and model.num_reg_images() - len(doubtful) >= self.needed:
                adjusted = adjust_model_by_silhouettes(remove_images(model, doubtful), self.image_set, report.wrong_masks, kind)
                self.figures["outlines"]["standing_out"] = doubtful
            self.figures["outlines"] |= {"miss_px": list(adjusted.missed_px)}
            return adjusted.model if adjusted.missed_px[1] <= ROUGH_MISS_PX else model

        self.figures["outlines"] = {}
        aligned = [TrackKind.ALIGNED] if self.figures.get("sharpened", {}).get("points") else []
        for kind in (*aligned, TrackKind.MATCHED):  # where what fits better lets one image stand out, all count alike
            changed, again = self._try(partial(change, kind=kind), model, report)
            if changed is not model:
                break
        self.figures["outlines"]["adjusted"] = changed is not model
        return changed, again

    def _try(
        self,
        change: Callable[[pycolmap.Reconstruction], pycolmap.Reconstruction],
        model: pycolmap.Reconstruction,
        report: ConsistencyReport,
    ) -> tuple[pycolmap.Reconstruction, ConsistencyReport]:
        changed = change(model)
        again = self.check(changed)
        culprits = list(again.culprits)
        if again.reason and culprits and model.num_reg_images() - len(culprits) >= self.needed:
            changed = change(remove_images(model, culprits))
            again = self.check(changed)
            if again.reason is None:
                self.figures["left_out"] = [*self.figures.get("left_out", []), *culprits]
        return (model, report) if again.reason else (changed, again)
