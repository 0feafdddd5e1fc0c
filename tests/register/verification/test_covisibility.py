"""Front and back that were laid onto each other: cameras stand side by side and share no points."""

import numpy as np
import pycolmap
import pytest

from helpers.side_points import add_side_points
from zeroshop_steps.register.scene.record import DuplicateStructure, Evidence, Finding, Record
from zeroshop_steps.register.verification.covisibility import count_covisible_points
from zeroshop_steps.register.verification.duplicate_structure import SHARED_POINTS, check_duplicate_structure
from zeroshop_steps.register.verification.verdict import judge, verify

NONE_OF_FOUR = (Finding("covisibility", 0.0, "0 of 4 pairs of neighbouring images share almost nothing"),)


def look_at_middle(azimuth_deg: float) -> pycolmap.Rigid3d:
    """A camera ten units from the middle of the scene."""
    angle = np.radians(azimuth_deg)
    outwards = np.array([np.cos(angle), np.sin(angle), 0.0])
    rotation = np.stack([np.cross(-outwards, [0.0, 0.0, 1.0]), [0.0, 0.0, -1.0], -outwards])
    return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ (outwards * 10.0))


def model_of(azimuths_deg: list[float], sides: list[int], share: float = 0.6) -> pycolmap.Reconstruction:
    """Cameras that see points near the middle: those of one side a random share of its 200 points, and none of another side's."""
    rng = np.random.default_rng(0)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=400, height=300, params=[400.0, 200.0, 150.0], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    places = rng.uniform(-1.0, 1.0, (max(sides) + 1, 200, 3))
    seen = [rng.random(200) < share for _ in sides]
    for number, azimuth_deg in enumerate(azimuths_deg):
        pose = look_at_middle(azimuth_deg)
        keypoints = camera.img_from_cam(places[sides[number]] @ pose.matrix()[:, :3].T + pose.matrix()[:, 3])
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=f"{number}.png", keypoints=keypoints, camera_id=1, image_id=number + 1), pose
        )
    add_side_points(model, places, sides, seen)
    return model


def check(model: pycolmap.Reconstruction, may_match=None, by_object=False) -> Evidence:
    """The verdict on a model."""
    return check_duplicate_structure(model, may_match, by_object)


def test_neighbours_of_one_side_share_points():
    model = model_of([0, 20, 40, 60, 80], [0] * 5)
    assert check(model) == Evidence({"neighbours": 4, "strangers": []}, NONE_OF_FOUR), "neighbours are up to 30 degrees apart"
    missed = count_covisible_points(model)
    assert missed.expected[0, 2] == 0 < missed.expected[0, 1] and missed.shared[0, 1] > 0.4 * missed.expected[0, 1]


def test_sides_that_lie_on_each_other_are_refused():
    azimuths = [0, 36, 72, 108, 144, 1, 37, 73, 109, 145]
    folded = model_of(azimuths, [0] * 5 + [1] * 5)
    found = check(folded)
    verdict = judge(found.findings)
    assert verdict.kind is DuplicateStructure and "5 of 5 pairs of neighbouring images, such as 0 and 5" in verdict.reason
    assert len(found.entries["strangers"]) == 5
    assert check(folded, lambda one, other: True).findings[0].strength == 0, "they match after all"
    few = check(folded, lambda one, other: one in "012")
    assert few.entries["strangers"] == [["3", "8"], ["4", "9"]] and few.findings[0].strength < 1, "two alone are allowed"
    assert check(model_of(azimuths, [0] * 10)).entries["strangers"] == []


def test_a_fault_ends_the_registration_with_all_that_is_known():
    model = model_of([0, 1, 2, 3], [0, 1, 0, 1])
    with pytest.raises(DuplicateStructure, match="distinct sides were merged") as error:
        verify(Record({"registered": 4}), [lambda: check(model), lambda: pytest.fail("asked although one check convinced")], model, 0.5)
    assert error.value.rejected is model and {"registered": 4, "neighbours": 6}.items() <= error.value.figures.items()


@pytest.mark.parametrize("azimuths", [[0, 90, 180, 270], [0, 40, 80, 120]])
def test_views_far_apart_are_not_judged(azimuths):
    assert count_covisible_points(model_of(azimuths, [0, 1, 0, 1])).find_noncovisible(SHARED_POINTS)[0] == 0


def test_a_single_stranger_among_few_neighbours_weighs_more_where_no_ground_tells_sides_apart():
    folded = model_of([0, 72, 144, 1, 60], [0, 0, 0, 1, 0])
    assert check(folded).findings[0].strength < 0.5, "excused on a ground"
    (finding,) = check(folded, by_object=True).findings
    assert finding.strength > 0.8 and "1 of 2 pairs of neighbouring images, such as 0 and 3, share almost nothing" in finding.found
    assert check(model_of([0, 20, 40, 60], [0] * 4), by_object=True).findings[0].strength == 0
