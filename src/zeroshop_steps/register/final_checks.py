"""What is asked about cameras before they are taken."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pycolmap

from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.register.final_refinement import Hypothesis
from zeroshop_steps.register.image_sequence import check_order
from zeroshop_steps.register.refinement.camera_deviation import check_deviations
from zeroshop_steps.register.scene.record import Evidence
from zeroshop_steps.register.verification.duplicate_structure import MayMatch, check_duplicate_structure
from zeroshop_steps.register.verification.epipolar_support import count_epipolar_support
from zeroshop_steps.register.verification.loop_gap import check_loop_gap
from zeroshop_steps.register.verification.photometric_consistency import check_photometric_consistency


@dataclass(frozen=True)
class FinalChecks:
    """What the checks need beside a model.

    Attributes:
        folder: of the undistorted images and, where there are any, masks.
        every_match: a database with all verified matches, also those that had no part in the model.
        may_match: is asked about neighbours that share almost no points, see `check_duplicate_structure`.
        by_object: whether the object's features alone gave the matches.
        seed: of all RANSAC loops.
        held: whether more than the photos holds the cameras: how loosely these do says little then.
    """

    folder: Path
    every_match: Path
    may_match: MayMatch | None
    by_object: bool
    seed: int = 0
    held: bool = False

    def about(self, hypothesis: Hypothesis, pinhole_model: pycolmap.Reconstruction) -> list[Callable[[], Evidence]]:
        """The checks of a model in the order of their cost; `pinhole_model` is the same without distortion."""
        checks: list[Callable[[], Evidence]] = [hypothesis.report.gather]
        if not self.held:
            checks.append(lambda: check_deviations(self.folder, self.by_object))
        if not hypothesis.merged:  # no matches hold submodels to each other
            images = None if self.by_object else self.folder / "images"
            checks += [
                lambda: check_order(count_epipolar_support(hypothesis.model, self.every_match)),
                lambda: check_loop_gap(hypothesis.model, pinhole_model, self.every_match, self.seed),
                lambda: check_duplicate_structure(pinhole_model, self.may_match, self.by_object, images),
            ]
        if self.by_object:
            checks.append(lambda: check_photometric_consistency(read_views(self.folder)[0]))
        return checks
