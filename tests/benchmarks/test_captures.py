"""The benchmark of captures: its table, its words for outcomes, and a tiny capture from its stored scene to the page."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import captures
from capture_benchmark.pictures import draw_six_sides
from capture_benchmark.results import compare_tables, summarize
from capture_benchmark.scores import name_outcome
from capture_benchmark.table import Capture, choose_captures, read_captures
from helpers.ball_scene import write_ball_scene
from helpers.capture_box import box_mesh
from helpers.paths import REPOSITORY
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.runtime.tables import read_table

TABLE = REPOSITORY / "benchmarks/captures/captures.csv"
HEADER = "name,object,kind,path,setting,expected,height_m,masks,cameras,mesh"
BALL = Capture("ball", "ball", "real", "ball/images", "", ("object",), None, "", "", "")


@pytest.fixture
def run_benchmark(stored: Path, capsys: pytest.CaptureFixture) -> Callable[..., tuple[int, str, str]]:
    """Runs the command line on the stored capture; returns its status and what it printed."""

    def run(*words: str) -> tuple[int, str, str]:
        places = {"--table": "table.csv", "--data": "data", "--references": "drawn", "--out": "out"}
        options = [word for name, place in places.items() for word in (name, str(stored / place))]
        return (captures.main([*options, "--method", "user_masks", *words]), *capsys.readouterr())

    return run


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """A table of one capture, whose scene is stored with masks, and whose drawn masks of three photos have half of its size."""
    (tmp_path / "table.csv").write_text(f"{HEADER}\nball,ball,real,ball/images,,object,,,,\n")
    (tmp_path / "data/ball/images").mkdir(parents=True)
    inputs = tmp_path / "out/inputs/real/ball"
    masks = write_ball_scene(inputs / "scene")
    for index, mask in enumerate(masks):
        write_mask(inputs / "scene/masks" / f"{index:06d}.png", mask)
        write_image(inputs / "capture/images" / f"{index:06d}.png", np.zeros((*mask.shape, 3), np.uint8))
        if index < 3:
            small = cv2.resize(mask.astype(np.uint8), (80, 60), interpolation=cv2.INTER_AREA) > 0
            write_mask(tmp_path / "drawn/ball" / f"IMG_{index}.png", small)
    write_json(inputs / "capture/capture.json", {"source_names": [f"IMG_{index}.jpg" for index in range(len(masks))]})
    return tmp_path


def test_a_stored_scene_is_masked_judged_and_shown(stored: Path, run_benchmark) -> None:
    status, _, errors = run_benchmark()
    assert status == 0, errors
    [row] = read_table(stored / "out/results.csv").to_dict("records")
    assert row["outcome"] in ("right", "poor") and float(row["mask_iou_median"]) > 0.93
    assert (row["references"], row["registered"], row["left_out"]) == ("3", "12", "0")
    assert float(row["wall_s"]) > 0 and float(row["cpu_s"]) > 0 and float(row["memory_mb"]) > 50
    page = (stored / "out/index.html").read_text()
    assert 'src="ball/masks.jpg"' in page and (stored / "out/ball/masks.jpg").stat().st_size > 1000

    made = (stored / "out/ball/masks.json").stat().st_mtime_ns
    (stored / "before.csv").write_bytes((stored / "out/results.csv").read_bytes())
    for index in range(3):  # now the references show something else
        write_mask(stored / "drawn/ball" / f"IMG_{index}.png", np.eye(60, 80) > 0)
    status, printed, errors = run_benchmark("--earlier", str(stored / "before.csv"))
    assert status == 0, errors
    assert (stored / "out/ball/masks.json").stat().st_mtime_ns == made, "masks of the same scene by the same code are not made again"
    [row] = read_table(stored / "out/results.csv").to_dict("records")
    assert row["outcome"] == "wrong" and "worse: ball:" in printed
    page = (stored / "out/index.html").read_text()
    assert page.index("Worse than in the earlier table") < page.index("Summary")

    photo = stored / "out/inputs/real/ball/scene/images/000000.png"
    write_image(photo, np.full((120, 160, 3), 90, np.uint8))
    run_benchmark()
    assert (stored / "out/ball/masks.json").stat().st_mtime_ns > made, "a changed scene is masked again"


def test_a_refused_registration_is_a_result(stored: Path, run_benchmark) -> None:
    write_failure([f"{stored / 'out/inputs/real/ball/scene'}/"], Failure("register.auto", "too few photos match"))
    status, _, errors = run_benchmark()
    assert status == 0, errors
    [row] = read_table(stored / "out/results.csv").to_dict("records")
    assert row["outcome"] == "wrongly refused" and "too few photos match" in row["reason"]


def test_missing_photos_and_foreign_masks_are_named(stored: Path, run_benchmark) -> None:
    write_mask(stored / "drawn/ball/IMG_99.png", np.eye(60, 80) > 0)
    status, _, errors = run_benchmark()
    assert status == 1 and "IMG_99" in errors
    (stored / "table.csv").write_text(f"{HEADER}\nother,other,real,nowhere,,object,,,,\n")
    status, _, errors = run_benchmark()
    assert status == 1 and "nowhere does not exist" in errors


@pytest.mark.parametrize(
    ("expected", "refusal", "median", "worst", "outcome"),
    [
        ("object", None, 0.96, 0.86, "right"),
        ("object", None, 0.96, 0.84, "poor"),
        ("object", None, 0.79, 0.70, "wrong"),
        ("object", None, None, None, "unmeasured"),
        ("object", "segment: too few masks are good", None, None, "wrongly refused"),
        ("object|refused", "segment: several things touch", None, None, "rightly refused"),
        ("moved", "segment: it moves", None, None, "rightly refused"),
        ("moved", None, 0.99, 0.99, "wrong"),
        ("moved", "segment: unexpected error: remap", None, None, "error"),
    ],
)
def test_outcomes(expected: str, refusal: str | None, median: float | None, worst: float | None, outcome: str) -> None:
    assert name_outcome(replace(BALL, expected=tuple(expected.split("|"))), refusal, median, worst) == outcome


def test_what_got_worse_is_found(tmp_path: Path) -> None:
    before = "name,outcome,mask_iou_median,mask_iou_worst\na,right,0.97,0.9\nb,poor,0.9,0.6\nc,wrong,0.5,0.1\n"
    (tmp_path / "before.csv").write_text(before)
    now = [
        {"name": "a", "outcome": "poor", "mask_iou_median": 0.97, "mask_iou_worst": 0.8},
        {"name": "b", "outcome": "poor", "mask_iou_median": 0.898, "mask_iou_worst": 0.59},
        {"name": "c", "outcome": "wrongly refused", "mask_iou_median": None, "mask_iou_worst": None},
    ]
    [(name, words)] = compare_tables(now, tmp_path / "before.csv")
    assert name == "a" and len(words) == 2


def test_halves_share_no_object_and_both_are_filled() -> None:
    table = read_captures(TABLE)
    rendered = [capture for capture in table if capture.kind == "rendered"]
    assert len(rendered) >= 60 and len({capture.object for capture in rendered}) >= 20
    halves = {half: choose_captures(table, half, []) for half in ("tune", "judge")}
    assert not {one.object for one in halves["tune"]} & {one.object for one in halves["judge"]}
    assert min(sum(one.kind == "rendered" for one in chosen) for chosen in halves.values()) >= 20


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("a,a,reel,p,,object,,,,", "kind is 'reel'"),
        ("a,a,real,p,,thing,,,,", "expected is 'thing'"),
        ("a,a,real,p,,object,tall,,,", "height_m is 'tall'"),
        ("a/b,a,real,p,,object,,,,", "a/b"),
        ("a,a,real,p,,object,,,,\na,a,real,p,,object,,,,", "several rows named a"),
    ],
)
def test_bad_rows_are_named(tmp_path: Path, row: str, words: str) -> None:
    (tmp_path / "table.csv").write_text(f"{HEADER}\n{row}\n")
    with pytest.raises(StepError, match=words):
        read_captures(tmp_path / "table.csv")


def test_summary_counts_halves_apart() -> None:
    rows = [
        {"half": "judge", "kind": "real", "outcome": "right", "mask_iou_median": 0.96, "mask_iou_worst": 0.9, "cpu_s": 2.0},
        {"half": "judge", "kind": "rendered", "outcome": "wrong", "mask_iou_median": 0.5, "mask_iou_worst": 0.1, "cpu_s": 3.0},
        {"half": "tune", "kind": "real", "outcome": "rightly refused", "mask_iou_median": None, "mask_iou_worst": None, "cpu_s": 1.0},
    ]
    found = {(row["half"], row["kind"]): row for row in summarize(rows)}
    assert found["judge", "all"]["captures"] == 2 and found["judge", "all"]["right or rightly refused, %"] == 50.0
    assert found["judge", "all"]["worst photo >= 0.85, %"] == 50.0 and found["tune", "all"]["right or rightly refused, %"] == 100.0


def test_a_mesh_is_drawn_from_six_sides() -> None:
    picture = draw_six_sides(box_mesh())
    height, width = picture.shape[:2]
    tiles = [picture[: height // 2, start : start + width // 6] for start in range(0, width, width // 6)]
    assert len(tiles) == 6 and all((tile < 200).any() and (tile[0] == 255).all() for tile in tiles)
    assert any((tile != tiles[0]).any() for tile in tiles[1:])
