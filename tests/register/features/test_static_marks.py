"""A timestamp in all photos: its features are left out and the user is told. What stands still for another reason is no mark."""

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.register import colmap
from zeroshop_steps.register.colmap import ColmapOptions, match_images
from zeroshop_steps.register.features.sift import SiftOptions, extract_features
from zeroshop_steps.register.features.static_marks import StaticMark, describe_marks, find_static_marks
from zeroshop_steps.register.matching.verified_matches import match_features
from zeroshop_steps.register.pipeline import StructureOptions
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import Stopwatch

WIDTH, HEIGHT, COUNT = 480, 360, 6
SIFT = SiftOptions(max_features=2000, enough_features=100, threads=1)


def texture(seed: int) -> np.ndarray:
    """A picture of blobs, turned so that the blobs of two do not lie on one grid."""
    noise = np.random.default_rng(seed).integers(60, 200, (50, 50), dtype=np.uint8)
    turn = cv2.getRotationMatrix2D((25, 25), 17.0 * seed, 22.0)
    turn[:, 2] += np.array([WIDTH, HEIGHT]) / 2 - 25
    return cv2.cvtColor(cv2.warpAffine(noise, turn, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP), cv2.COLOR_GRAY2RGB)


def stamp(image: np.ndarray, number: int) -> np.ndarray:
    """The picture with the time on a dark plate; its last digit changes."""
    stamped = image.copy()
    stamped[HEIGHT - 52 : HEIGHT - 8, WIDTH - 258 :] = 20
    cv2.putText(stamped, f"2026-11-28 15:2{number}", (WIDTH - 250, HEIGHT - 20), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255, 200, 0), 2)
    return stamped


def capture(folder: Path, pictures: list[np.ndarray], stamped: bool) -> ImageSet:
    for number, picture in enumerate(pictures):
        write_image(folder / "images" / f"{number:06d}.png", stamp(picture, number) if stamped else picture)
    return read_image_set(folder)


def read_features(database: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    with pycolmap.Database.open(database) as opened:
        ids = sorted(image.image_id for image in opened.read_all_images())
        return [(opened.read_keypoints(one), opened.read_descriptors(one).data) for one in ids]


def count_ties(database: Path) -> int:
    with pycolmap.Database.open(database) as opened:
        return sum(len(pair.inlier_matches) > 0 for pair in opened.read_two_view_geometries()[1])


def on_mark(keypoints: np.ndarray) -> np.ndarray:
    """(K,) bool: the keypoints on the date, which does not change."""
    columns, rows = keypoints[:, 0], keypoints[:, 1]
    return (rows > HEIGHT - 45) & (rows < HEIGHT - 15) & (columns > WIDTH - 250) & (columns < WIDTH - 100)


def moving() -> list[np.ndarray]:
    return [texture(seed) for seed in range(COUNT)]


def at_rest() -> list[np.ndarray]:
    """Frames of a film whose camera hardly moves, with noise."""
    noise = np.random.default_rng(1)
    return [np.clip(texture(0) + noise.normal(0, 4, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8) for _ in range(COUNT)]


def before_background(left_px: int) -> list[np.ndarray]:
    """What turns in the middle of a still background, from a column on; left of it, all is plain."""
    pictures = []
    for seed in range(COUNT):
        picture = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
        picture[:, left_px:] = texture(99)[:, left_px:]
        picture[60:300, 60:300] = texture(seed)[60:300, 60:300]
        pictures.append(picture)
    return pictures


@pytest.mark.parametrize(("count", "most_left"), [(COUNT, 0), (5, 2)])
def test_a_timestamp_is_left_out(tmp_path, count, most_left):
    """All of it of six photos; of five, features that three of the four others do not show stay."""
    images = capture(tmp_path, moving()[:count], stamped=True)
    database = tmp_path / "d.db"
    extract_features(database, images, SIFT)
    before = read_features(database)
    marks = find_static_marks(database, images)
    assert marks.found == (StaticMark("lower right corner", count, count),)
    match_features(database, SIFT)
    assert count_ties(database) == count * (count - 1) / 2  # else the mark would do no harm
    marks.leave_out(database, images)
    for (points, descriptors), (kept, described) in zip(before, read_features(database), strict=True):
        assert on_mark(points).sum() > 20 and on_mark(kept).sum() <= most_left
        assert len(kept) == len(described)
        clear, rest = ((all_of[:, 1] < HEIGHT - 80) | (all_of[:, 0] < WIDTH - 290) for all_of in (points, kept))
        np.testing.assert_array_equal(points[clear], kept[rest])
        np.testing.assert_array_equal(descriptors[clear], described[rest])


@pytest.mark.parametrize(
    ("pictures", "stamped"),
    [
        pytest.param(moving(), False, id="no mark"),
        pytest.param(at_rest(), True, id="camera at rest"),
        pytest.param(before_background(0), False, id="still background"),
        pytest.param(before_background(330), False, id="still thing beside what turns"),
        pytest.param([texture(0), texture(1), texture(2), texture(3)], True, id="too few photos"),
    ],
)
def test_what_is_no_mark_stays(tmp_path, pictures, stamped):
    images = capture(tmp_path, pictures, stamped)
    extract_features(tmp_path / "d.db", images, SIFT)
    before = read_features(tmp_path / "d.db")
    marks = find_static_marks(tmp_path / "d.db", images)
    assert not marks.found and not marks.places_px
    marks.leave_out(tmp_path / "d.db", images)
    np.testing.assert_equal(read_features(tmp_path / "d.db"), before)


def test_a_mark_is_found_where_some_frames_stand_still(tmp_path):
    images = capture(tmp_path, moving()[1:] + at_rest()[:2], stamped=True)
    extract_features(tmp_path / "d.db", images, SIFT)
    assert [mark.where for mark in find_static_marks(tmp_path / "d.db", images).found] == ["lower right corner"]


def test_photos_that_share_a_timestamp_alone_have_no_ties(tmp_path):
    """Nor do features of stretched copies bring the mark back."""
    images = capture(tmp_path, moving(), stamped=True)
    graph = match_images(tmp_path / "d.db", images, ColmapOptions(sift=SIFT), Stopwatch())
    assert count_ties(tmp_path / "d.db") == 0
    assert graph.tilted == tuple(images.names)
    assert not any(on_mark(points).any() for points, _ in read_features(tmp_path / "d.db"))
    evidence = graph.evidence()
    assert evidence.entries["static_marks"] == [{"where": "lower right corner", "images": COUNT, "compared": COUNT}]
    assert describe_marks([StaticMark("lower edge", 5, 6)])[0].startswith("a mark at the lower edge stands still in 5 of 6 photos")
    assert len(evidence.warnings) == 1 and "a mark in the lower right corner stands still in 6 of 6 photos" in evidence.warnings[0]


def test_a_watermark_all_over_the_photos_ties_nothing(tmp_path):
    """Its words repeat, so none of them is the best match of another by far."""
    tiles = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for row in range(30, HEIGHT, 60):
        for column in range(-40 + row // 60 % 2 * 50, WIDTH, 130):
            cv2.putText(tiles, "SAMPLE", (column, row), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2)
    pictures = [np.where(tiles > 0, 0.3 * picture + 0.7 * tiles, picture).astype(np.uint8) for picture in moving()[:4]]
    graph = match_images(tmp_path / "d.db", capture(tmp_path, pictures, stamped=False), ColmapOptions(sift=SIFT), Stopwatch())
    assert count_ties(tmp_path / "d.db") == 0 and not graph.on_turntable


def test_marks_are_not_looked_for_on_an_object_alone(tmp_path, monkeypatch):
    images = capture(tmp_path, moving()[:3], stamped=True)
    monkeypatch.setattr(colmap, "extract_features", lambda database, image_set, *_: extract_features(database, image_set, SIFT))
    monkeypatch.setattr(colmap, "find_static_marks", lambda *_: pytest.fail("looked for"))
    alone = ColmapOptions(sift=SIFT, structure=StructureOptions(object_only=True))
    monkeypatch.setattr(colmap, "choose_name_pairs", lambda *_: [(images.names[0], images.names[1])])
    assert match_images(tmp_path / "d.db", images, alone, Stopwatch()).marks == ()
