"""Passes of an object that was turned over: which way counts, what is written, and a whole join of rendered passes."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.coarse_ground import coarse_ground
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import choose_standing, read_views
from zeroshop_steps.join import evidence
from zeroshop_steps.join.evidence import (
    LARGEST_MISS_PX,
    MANY_PAIRS,
    SAME_SIDE_DEG,
    SURE_PAIRS,
    Judgement,
    choose,
    is_same,
    judge_ways,
)
from zeroshop_steps.join.passes import explain, explain_joined
from zeroshop_steps.join.ways import Way
from zeroshop_steps.register.submodels.appearance import Likeness
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import Failure, read_failure, write_failure
from zeroshop_steps.runtime.files import read_json

SAME, NOTHING = Likeness(20, 2000, 0.85, 0.05, 300, 0.05), Likeness(0, 0, 0.0, 0.0, 0, 0.0)
OTHER = Likeness(20, 2000, 0.4, 0.7, 300, 0.8)


def judged(pairs: int, miss_px: float, likeness: Likeness, elsewhere_px: float | None = None) -> Judgement:
    return Judgement(Way(np.eye(4), pairs), miss_px, likeness, elsewhere_px)


@pytest.mark.parametrize(
    ("found", "right"),
    [
        ([], False),
        ([judged(100, 0.2, SAME)], True),
        ([judged(20, 0.2, SAME)], True),
        ([judged(SURE_PAIRS, 0.2, NOTHING)], True),
        ([judged(20, 0.2, NOTHING)], False),  # fits, but nothing shows that it is right
        ([judged(100, 2 * LARGEST_MISS_PX, SAME)], False),
        ([judged(100, 0.2, OTHER)], False),
        ([judged(100, 0.2, SAME), judged(60, 0.2, OTHER)], True),
        ([judged(100, 0.2, SAME), judged(60, 0.2, SAME)], False),  # print on two sides, and both fit
        ([judged(100, 0.2, SAME), judged(20, 0.2, NOTHING)], False),
        ([judged(0, 0.5, NOTHING, 7.0), judged(0, 7.0, NOTHING, 0.5)], True),  # outlines that fit in one way alone
        ([judged(0, 0.1, NOTHING, 1.6), judged(0, 1.6, NOTHING, 0.1)], True),
        ([judged(0, 0.1, NOTHING, 1.6), judged(0, 1.6, SAME, 0.1)], False),  # but pictures say the other
        ([judged(0, 0.5, NOTHING, 1.0), judged(0, 1.0, NOTHING, 0.5)], False),
        ([judged(0, 0.5, SAME, 1.0), judged(0, 1.0, OTHER, 0.5)], True),
        ([judged(0, 0.5, OTHER, 7.0), judged(0, 7.0, NOTHING, 0.5)], False),
        ([judged(0, 2.2, NOTHING, 9.0), judged(0, 9.0, NOTHING, 2.2)], False),  # masks are too far off to tell
    ],
)
def test_exactly_one_way_must_be_right_and_none_open(found, right):
    assert (choose(found) is not None) == right
    if not right:
        assert "pass 2 is left out" in explain(2, found)


def test_the_reason_names_what_contradicts():
    assert "outlines of pass 2 contradict" in explain(2, [judged(100, 2 * LARGEST_MISS_PX, SAME)])
    assert "the pictures differ" in explain(2, [judged(100, 0.2, OTHER)])
    assert "too little print" in explain(2, [judged(20, 0.2, NOTHING)])
    assert "neither print nor outlines" in explain(2, [judged(0, 2 * LARGEST_MISS_PX, NOTHING, 9.0)])


def render_and_register(folder, model, seed):
    common = ["--width", "320", "--height", "240", "--seed", str(seed), "--threads", "1", "--views-per-ring", "6"]
    words = ["--method", "raycast", "--model", str(model / "model.ply"), "--scene", "su_h", *common, "--out", str(folder / "capture")]
    with coarse_ground(1024):
        assert stage_main("zeroshop_steps.synthetic", words) == 0
    words = [
        "--method",
        "truth",
        "--capture",
        str(folder / "capture"),
        "--scene",
        "su_h",
        "--threads",
        "1",
        "--out",
        str(folder / "cameras"),
    ]
    assert stage_main("zeroshop_steps.register", words) == 0


@pytest.fixture(scope="module")
def passes(tmp_path_factory):
    """A gelatin carton, standing and turned over, on two prints, with true cameras."""
    folder = tmp_path_factory.mktemp("passes")
    model, turned = folder / "model", folder / "turned"
    assert stage_main("zeroshop_steps.synthetic", ["--method", "demo_objects", "--object", "gelatin_carton", "--out", str(model)]) == 0
    assert stage_main("zeroshop_steps.synthetic", ["--method", "turned_model", "--model", str(model), "--out", str(turned)]) == 0
    for number, shown in enumerate((model, turned), start=1):
        render_and_register(folder / str(number), shown, number)
    return folder


@pytest.mark.slow
def test_a_carton_turned_over_is_joined_in_the_frame_of_its_first_pass(passes):
    captures = ["--captures", str(passes / "1/capture"), str(passes / "2/capture"), "--turned", str(passes / "turned")]
    words = ["--method", "captures", *captures, "--scene", "su_f", "--out", str(passes / "capture")]
    assert stage_main("zeroshop_steps.join", words) == 0
    cameras = ["--cameras", str(passes / "1/cameras"), str(passes / "2/cameras")]
    assert stage_main("zeroshop_steps.join", ["--method", "passes", *cameras, "--threads", "1", "--out", str(passes / "joined")]) == 0
    record = read_json(passes / "joined/registration.json")
    assert record["registered"] == 24 and [one["joined"] for one in record["passes"]] == [True, True]
    truth = {camera.name: camera for camera in read_sparse_model(passes / "capture/truth").cameras}
    views, model = read_views(passes / "joined")
    assert len(choose_standing(views)) == 12
    # The first pass has the true cameras, so the second must have them, too: no alignment.
    off_mm = [np.linalg.norm(view.camera.centre_in_world - truth[view.camera.name].centre_in_world) for view in views]
    assert max(off_mm) < 1.0 and max(off_mm[:12]) < 1e-6
    # The second pass's ground is not in it: it would lie around the carton's top.
    info = read_json(passes / "model/model_info.json")
    upper = model.points[model.points[:, 2] > 0]
    beside = (np.abs(upper[:, :2]) > np.array([info["size_x"], info["size_y"]]) / 2 + 2.0).any(1)
    assert beside.sum() < 0.02 * len(read_sparse_model(passes / "2/cameras/sparse").points)


@pytest.mark.slow
def test_the_same_pass_twice_is_left_out_and_said(passes, capsys):
    words = ["--method", "passes", "--threads", "1", "--cameras", *[str(passes / "1/cameras")] * 2]
    assert stage_main("zeroshop_steps.join", [*words, "--out", str(passes / "twice")]) == 0
    assert "the pictures of pass 2 are those of pass 1: pass 2 is left out" in capsys.readouterr().err
    assert read_json(passes / "twice/registration.json")["registered"] == 12


@pytest.mark.slow
def test_a_later_pass_that_failed_is_left_out_and_the_first_must_not_fail(passes, tmp_path, capsys):
    write_failure([f"{tmp_path / 'failed'}/"], Failure("register.auto", "only 3 of 12 images registered"))
    words = ["--method", "passes", "--threads", "1", "--out", str(tmp_path / "joined"), "--record-failure", f"{tmp_path / 'joined'}/"]
    assert stage_main("zeroshop_steps.join", [*words, "--cameras", str(passes / "1/cameras"), str(tmp_path / "failed")]) == 0
    assert "pass 2 failed (only 3 of 12 images registered): pass 2 is left out" in capsys.readouterr().err
    assert len(read_views(tmp_path / "joined")[0]) == 12
    assert [one["joined"] for one in read_json(tmp_path / "joined/passes.json")["passes"]] == [True, False]
    assert stage_main("zeroshop_steps.join", [*words, "--cameras", str(tmp_path / "failed"), str(passes / "1/cameras")]) == 0
    assert "pass 1, in whose frame all stand" in read_failure(tmp_path / "joined").reason


def test_passes_without_masks_are_refused(tmp_path, capsys, carton_cameras_without_masks):
    cameras = ["--cameras", *[str(carton_cameras_without_masks)] * 2]
    assert stage_main("zeroshop_steps.join", ["--method", "passes", *cameras, "--out", str(tmp_path / "joined")]) == 1
    assert "has no masks; passes are joined by the object alone" in capsys.readouterr().err
    assert not (tmp_path / "joined").exists()


@pytest.mark.parametrize("turned_deg", [5.0, 60.0, 180.0])
def test_a_pass_that_shows_no_other_side_is_said(turned_deg):
    first, other = (SimpleNamespace(group=SimpleNamespace(up=np.array([0.0, 0.0, 1.0]))) for _ in range(2))
    way = np.eye(4)
    way[:3, :3] = 2.0 * Rotation.from_euler("x", turned_deg, degrees=True).as_matrix()
    reason = explain_joined(2, Judgement(Way(way, 100), 0.2, SAME), first, other)
    assert (reason is not None) == (turned_deg < SAME_SIDE_DEG)


@pytest.mark.parametrize(
    ("across", "turned_deg", "same"), [(50.0, 12.0, True), (50.0, 40.0, False), (4.0, 25.0, True), (4.0, 120.0, False)]
)
def test_ways_are_one_by_their_turn_and_those_of_thin_things_by_how_far_they_move(across, turned_deg, same):
    rolls = [Rotation.from_euler("x", 30 * index, degrees=True).apply([1.0, 0.0, across]) for index in range(12)]
    group = SimpleNamespace(points=np.array([[50.0, 0, 0], [-50.0, 0, 0], *rolls]), radius=60.0)
    sight = SimpleNamespace(group=group)
    way = np.eye(4)
    way[:3, :3] = Rotation.from_euler("x", turned_deg, degrees=True).as_matrix()
    assert is_same(Way(way, 30), Way(np.eye(4), 30), sight, sight) == same


@pytest.mark.parametrize(
    ("pairs", "turned_deg", "rival", "right"),
    [
        (MANY_PAIRS, 180.0, SAME, True),  # print is enough, and outlines are not asked
        (30, 180.0, OTHER, True),
        (30, 180.0, SAME, False),
        (MANY_PAIRS, 0.0, OTHER, True),
        (MANY_PAIRS, 0.0, SAME, False),  # a clamp whose sides look alike matches as if it had not been turned over
    ],
)
def test_a_doubtful_way_must_be_the_only_one_that_outlines_and_pictures_allow(monkeypatch, pairs, turned_deg, rival, right):
    group = SimpleNamespace(up=np.array([0.0, 0.0, 1.0]), points=50 * np.eye(3), radius=50.0)
    sight = SimpleNamespace(group=group)
    way, flipped = np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])
    way[:3, :3] = Rotation.from_euler("x", turned_deg, degrees=True).as_matrix()
    monkeypatch.setattr(evidence, "judge", lambda way, *_: Judgement(way, 0.2, SAME))
    found = [Judgement(Way(way, 0), 0.2, SAME, 0.3), Judgement(Way(flipped @ way, 0), 0.3, rival, 0.2)]
    assert (choose(judge_ways([Way(way, pairs)], sight, sight, lambda: found)) is not None) == right
