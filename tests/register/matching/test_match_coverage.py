"""Where sides look alike, cameras are found again from pairs of photos whose matches lie all over the pictures."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.register import colmap
from zeroshop_steps.register.colmap import ColmapOptions
from zeroshop_steps.register.matching.match_coverage import LEAST_CELLS, delete_pairs_of_low_coverage
from zeroshop_steps.register.matching.turntable import StationaryMatches
from zeroshop_steps.register.matching.view_graph import ViewGraph
from zeroshop_steps.register.pipeline import StructureOptions
from zeroshop_steps.register.scene.image_set import CELLS, read_image_set
from zeroshop_steps.register.scene.record import DuplicateStructure, Inconsistent, RegistrationFailed, TooFewRegistered

WIDTH, HEIGHT = 320, 240
REASONS = ("the first reason", "the second reason")


def fill(path: Path, spread: dict[tuple[int, int], int]) -> None:
    """A database of pairs of images, each with one match in the middle of so many cells of both pictures."""
    cells = np.arange(CELLS**2)
    keypoints = (np.stack([cells % CELLS, cells // CELLS], axis=1) + 0.5) / CELLS * [WIDTH, HEIGHT]
    with pycolmap.Database.open(path) as opened:
        camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[300.0, WIDTH / 2, HEIGHT / 2])
        camera_id = opened.write_camera(camera)
        for number in sorted({image for pair in spread for image in pair}):
            image_id = opened.write_image(pycolmap.Image(name=f"{number}.png", camera_id=camera_id))
            opened.write_keypoints(image_id, keypoints.astype(np.float32))
        for (first, second), count in spread.items():
            matches = np.stack([cells[:count], cells[:count]], axis=1).astype(np.uint32)
            matches = np.repeat(matches, 9, axis=0)  # many matches in a cell are no more than one
            opened.write_matches(first, second, matches)
            opened.write_two_view_geometry(first, second, pycolmap.TwoViewGeometry(inlier_matches=matches))


def test_pairs_whose_matches_cover_little_are_left_out(tmp_path):
    fill(tmp_path / "database.db", {(1, 2): CELLS**2, (1, 3): LEAST_CELLS, (2, 3): LEAST_CELLS - 1})
    assert delete_pairs_of_low_coverage(tmp_path / "database.db") == 1
    with pycolmap.Database.open(tmp_path / "database.db") as opened:
        assert {(1, 2): opened.exists_two_view_geometry(1, 2), (2, 3): opened.exists_two_view_geometry(2, 3)} == {
            (1, 2): True,
            (2, 3): False,
        }
        assert opened.exists_matches(1, 3) and not opened.exists_matches(2, 3)


@pytest.fixture
def image_set(tmp_path):
    for number in (1, 2, 3):
        write_image(tmp_path / "capture/images" / f"{number}.png", np.full((HEIGHT, WIDTH, 3), number, np.uint8))
    return read_image_set(tmp_path / "capture")


def run(tmp_path, image_set, monkeypatch, kinds, options, gaps=({}, {})):
    """The record, where each reconstruction but those past these kinds of failures fails; and what each was asked."""
    asked = []

    def reconstruct(database, image_set, out, options, record, *_, **more):
        asked.append((database, options.compare_pictures, sorted(path.name for path in out.iterdir() if path.name == "images")))
        # What was left out may contradict the cameras: the whole database is asked.
        assert more.get("all_matches") == (None if len(asked) == 1 else asked[0][0])
        (out / "images").mkdir()
        record = record.add(**gaps[len(asked) - 1])
        if len(asked) <= len(kinds):
            raise record.fail(REASONS[len(asked) - 1], kind=kinds[len(asked) - 1])
        return record.add(registered=3)

    monkeypatch.setattr(colmap, "reconstruct", reconstruct)
    monkeypatch.setattr(colmap, "_check_spread", lambda *_: None)

    def match(database, *_):
        fill(database, {(1, 2): CELLS**2, (2, 3): 1})
        return ViewGraph(1000.0, 0, "exif", 3, StationaryMatches(0.0, 0.0, 0.0), False)

    out = tmp_path / "out"
    out.mkdir()
    try:
        return colmap.register(image_set, out, ColmapOptions(structure=options), match), asked
    except RegistrationFailed as error:
        return str(error), asked


def test_cameras_that_are_wrong_are_found_again_from_wide_pairs_and_their_pictures_compared(tmp_path, image_set, monkeypatch):
    record, asked = run(tmp_path, image_set, monkeypatch, [DuplicateStructure], StructureOptions(leave_out=True))
    assert record["narrow_pairs"] == 1 and f"were refused ({REASONS[0]})" in record["warnings"][0]
    assert [compared for _, compared, _ in asked] == [False, True]
    assert asked[0][0] != asked[1][0] and asked[1][2] == []  # nothing of the wrong cameras is left


@pytest.mark.parametrize(
    ("kinds", "options", "tries"),
    [
        ([DuplicateStructure, TooFewRegistered], StructureOptions(leave_out=True), 2),
        ([TooFewRegistered], StructureOptions(leave_out=True), 1),
        ([Inconsistent], StructureOptions(), 1),
        ([Inconsistent], StructureOptions(leave_out=True, object_only=True), 1),
    ],
)
def test_the_first_reason_stays_where_wide_pairs_do_not_help_or_are_not_asked(tmp_path, image_set, monkeypatch, kinds, options, tries):
    error, asked = run(tmp_path, image_set, monkeypatch, kinds, options)
    assert error == REASONS[0] and len(asked) == tries


@pytest.mark.parametrize(("folded", "left", "refused"), [(True, True, True), (True, False, False), (False, True, False)])
def test_cameras_that_were_folded_must_close_their_gap(tmp_path, image_set, monkeypatch, folded, left, refused):
    gaps = ({"gap_evidence": {"folded": folded}}, {"gap_evidence": {"folded": False}} if left else {})
    found, asked = run(tmp_path, image_set, monkeypatch, [DuplicateStructure], StructureOptions(leave_out=True), gaps)
    assert len(asked) == 2 and (found == REASONS[0]) == refused
