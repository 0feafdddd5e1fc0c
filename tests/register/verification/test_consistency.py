"""Each check alone can find a model wrong, and names whom it blames."""

import json
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from zeroshop_steps.register.mapping.reregistration import measure_reprojection_errors_px
from zeroshop_steps.register.scene.record import Fault, Finding, Inconsistent
from zeroshop_steps.register.silhouettes.coherence import SilhouetteCoherence
from zeroshop_steps.register.verification.consistency import ConsistencyLimits, ConsistencyReport, find_contradictions, find_unsure
from zeroshop_steps.register.verification.epipolar_support import EpipolarSupport
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY

NAMES = tuple("abcdefgh")


def doubt(unexplained_px=0.0, contradicting=0, error_px=0.3, link=100, most=MAX_WRONG_PROBABILITY):
    """The verdict on eight images that agree, but for what is said about image `c`."""
    count = len(NAMES)
    disagreement_px = np.zeros((count, count))
    disagreement_px[2] = unexplained_px
    coherence = SilhouetteCoherence(NAMES, np.where(np.arange(count) == 2, unexplained_px, 0.5), disagreement_px)
    supporting = np.full((count, count), 100)
    supporting[2] = supporting[:, 2] = link
    np.fill_diagonal(supporting, 0)
    against = np.zeros((count, count), int)
    against[2] = against[:, 2] = contradicting
    errors_px = dict.fromkeys(NAMES, 0.3) | {"c": error_px}
    ones, limits = dict.fromkeys(NAMES, 1.0), ConsistencyLimits()
    mask_limits_px = dict.fromkeys(NAMES, limits.unexplained_px)
    evidence = EpipolarSupport(NAMES, supporting, against)
    found = find_contradictions(coherence, evidence, errors_px, limits, ones, mask_limits_px)
    report = ConsistencyReport(coherence, evidence, errors_px, found, max_wrong_probability=most)
    if not report.is_doubtful:
        return None, report.culprits
    assert issubclass(report.verdict.kind, Inconsistent) == (link == 100)
    return report.verdict.reason, report.culprits


def test_a_model_that_everything_bears_out_passes():
    assert doubt() == (None, ())


def test_masks_find_a_wrong_camera():
    reason, culprits = doubt(unexplained_px=40.0)
    assert "mask of c miss the other masks by 40.0 px" in reason and culprits == ("c",)


def test_contradicting_matches_find_a_wrong_camera():
    reason, culprits = doubt(contradicting=300)
    assert "matches of c contradict it" in reason and culprits == ("c",)


def test_a_lower_threshold_doubts_what_the_usual_one_does_not():
    assert doubt(contradicting=100) == (None, ())
    assert doubt(contradicting=100, most=0.03)[1] == ("c",)


def test_a_poor_fit_finds_a_wrong_camera():
    reason, culprits = doubt(error_px=1.2)
    assert "c fits with 1.20 px" in reason and culprits == ("c",)


def test_a_loose_link_is_found():
    reason, culprits = doubt(link=5)
    assert "only 35 matches hold c" in reason and culprits == ("c",)


def test_an_error_without_bounds_is_a_fault_wherever_it_stands():
    reason, culprits = doubt(error_px=np.inf)
    assert "c sees no points of the model, or most of them lie behind it" in reason and culprits == ("c",)


@pytest.mark.parametrize("behind, finite", [(1, True), (4, False)])
def test_points_behind_a_camera_do_not_hide_its_error(behind, finite):
    """Where one of nine does, and where four of seven do. With the median of what is not a number, no limit was ever exceeded."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="SIMPLE_PINHOLE", width=200, height=200, params=[200.0, 100.0, 100.0], camera_id=1)
    )
    pixels = np.random.default_rng(0).uniform(50, 150, (9 if finite else 7, 2))
    for number in (1, 2):
        image = pycolmap.Image(name=f"{number}.png", keypoints=pixels + [0.25, 0.0], camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    for index, pixel in enumerate(pixels):
        depth = -5.0 if index < behind else 5.0
        track = pycolmap.Track()
        for number in (1, 2):
            track.add_element(number, index)
        model.add_point3D(np.array([*((pixel - 100.0) / 200.0 * depth), depth]), track, np.zeros(3, np.uint8))
    errors_px = measure_reprojection_errors_px(model)
    assert all(np.isfinite(error) == finite for error in errors_px.values())
    evidence = EpipolarSupport(("1.png", "2.png"), np.array([[0, 9], [9, 0]]), np.zeros((2, 2), int))
    figures = ConsistencyReport(None, evidence, errors_px).figures()
    assert json.loads(json.dumps(figures, allow_nan=False))["error_px"]["1.png"] == (0.25 if finite else None)


@pytest.mark.parametrize(("points", "contradicting", "unsure"), [(60, 50, ["4.png"]), (60, 5, []), (150, 50, [])])
def test_an_image_that_few_points_hold_and_many_matches_contradict_is_unsure(points, contradicting, unsure):
    names = ("1.png", "2.png", "3.png", "4.png")
    images = {n: SimpleNamespace(name=name, has_pose=True, num_points3D=300) for n, name in enumerate(names)}
    images[3].num_points3D = points
    against = np.zeros((4, 4), int)
    against[3, 0] = against[0, 3] = contradicting
    supporting = np.full((4, 4), 300)
    supporting[3], supporting[:, 3] = 20, 20
    assert find_unsure(SimpleNamespace(images=images), EpipolarSupport(names, supporting, against)) == unsure


def test_a_lens_that_no_lens_is_blames_no_image():
    evidence = EpipolarSupport(NAMES, np.full((8, 8), 100), np.zeros((8, 8), int))
    weak = (Finding("error", 0.4, "c fits a little worse", ("c",)),)
    report = ConsistencyReport(
        None, evidence, dict.fromkeys(NAMES, 0.3), weak, Fault("the distortion of its lens is not invertible", Inconsistent)
    )
    assert report.is_doubtful and report.culprits == ()
