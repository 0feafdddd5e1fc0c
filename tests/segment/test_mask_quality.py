"""A mask is judged by what the others say: those that contradict, jump in size or vanish are found, and too many end the step."""

import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.quality.mask_quality import check_enough_good, compare_with_hull, describe_quality, touches_border
from zeroshop_steps.segment.record import show_rejected_masks, warn_of_dropped

NAMES = [f"{index:06d}.png" for index in range(10)]


def disk(radius=30, x=60):
    rows, columns = np.mgrid[:100, :120]
    return (columns - x) ** 2 + (rows - 50) ** 2 < radius**2


def judged(**odd):
    """The qualities of ten disks, some of them replaced: {"m3": mask}."""
    masks = [odd.get(f"m{index}", disk()) for index in range(10)]
    return compare_with_hull(masks, [disk()] * 10)


def test_agreeing_masks_are_good():
    qualities = judged(m4=disk(31))
    assert all(quality.fault is None for quality in qualities)
    check_enough_good(qualities, NAMES, [])
    assert describe_quality(qualities, NAMES)["good_masks"] == 10


@pytest.mark.parametrize(
    ("mask", "fault"),
    [(disk() & False, "empty"), (disk(x=80), "contradict"), (disk(20), "contradict"), (disk(34), "contradict|times as large")],
)
def test_a_bad_mask_is_found(mask, fault):
    qualities = judged(m3=mask)
    assert [bool(quality.fault) for quality in qualities] == [index == 3 for index in range(10)]
    assert any(word in qualities[3].fault for word in fault.split("|"))
    assert list(describe_quality(qualities, NAMES)["dropped"]) == ["000003.png"]


def test_an_object_cut_off_is_told():
    masks = [disk(x=15 if index == 2 else 60) for index in range(10)]
    qualities = compare_with_hull(masks, masks)
    assert [touches_border(quality) for quality in qualities] == [index == 2 for index in range(10)]


def test_masks_that_vanish_in_half_of_the_frames_end_the_step():
    nothing = disk() & False
    with pytest.raises(StepError, match="only 5 of 10 masks are good, 8 are needed.*000000.png: the mask is empty"):
        check_enough_good(judged(**{f"m{index}": nothing for index in range(5)}), NAMES, [])


def test_refused_masks_are_shown(tmp_path):
    """The picture shows every image with its mask, the bad ones crossed out, and the error names it."""
    paths = [tmp_path / name for name in NAMES]
    masks = [disk() & (index > 4) for index in range(10)]
    for path in paths:
        write_image(path, np.full((100, 120, 3), 128, np.uint8))
    picture = tmp_path / "logs" / "segment.log.png"
    with pytest.raises(StepError, match="all masks are shown in .*segment.log.png"), show_rejected_masks(paths, picture):
        check_enough_good(compare_with_hull(masks, [disk()] * 10), NAMES, masks)
    sheet = read_image(picture)
    bad, good = sheet[: len(sheet) // 2], sheet[len(sheet) // 2 :]
    assert (good == 128).all(2).mean() > 0.2 and (bad == 128).all(2).mean() < 0.001
    with show_rejected_masks(paths, picture):
        pass
    assert not picture.exists(), "of an earlier run"


@pytest.mark.parametrize(("shown", "wide"), [(0.68, True), (0.98, False)])
def test_what_a_wide_lens_cut_off_is_told(capsys, shown, wide):
    warn_of_dropped({"cut_off": ["000003.png"]}, {"lens": {"model": "OPENCV_FISHEYE", "shown_share": shown}})
    said = capsys.readouterr().err
    assert (
        "cut off at the border in 000003.png" in said and ("undistorted, they show 68% of the photos, as the lens is wide" in said) == wide
    )
