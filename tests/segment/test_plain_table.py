"""On a plain table, which has no points of its own, the object and the plane are found, too."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.table_scene import ball_mask, table_views
from zeroshop_steps.geometry.cameras import SparseModel
from zeroshop_steps.geometry.scene_support import fit_scene_support
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment import support_plane
from zeroshop_steps.segment.ground import GroundPicture, build_ground_picture
from zeroshop_steps.segment.mask_quality import MasksRejected, check_points_covered
from zeroshop_steps.segment.plain_ground import MOST_ODDS, SHADOW_ODDS, find_print, find_risen_points, fit_plain_ground, join_odds
from zeroshop_steps.segment.plane_search import find_scene_support, find_support_below, guess_scene_support, propose_supports
from zeroshop_steps.segment.support_plane import find_masks
from zeroshop_steps.segment.voxel_carving import VoxelGrid, render_silhouettes
from zeroshop_steps.segment.windows import Window, choose_windows, cut_map, cut_views, lay_back, take_whole

BALL = (0.0, 0.0, 0.45)
VIEWS, FEW_VIEWS = 12, 8
NO_POINTS = np.zeros((0, 3))


@pytest.fixture(scope="module")
def plain_scene(tmp_path_factory):
    return table_views(tmp_path_factory.mktemp("plain"), [[BALL]] * VIEWS, plain=True)


@pytest.fixture(scope="module")
def plain_scene_of_few_views(tmp_path_factory):
    return table_views(tmp_path_factory.mktemp("few"), [[BALL]] * FEW_VIEWS, plain=True)


def test_a_plain_table_has_no_points_and_a_guess_serves(plain_scene):
    views, model = plain_scene
    with pytest.raises(StepError, match="no support plane"):
        fit_scene_support(model, views)
    support = guess_scene_support(model, views)
    assert support.normal @ [0, 0, 1] > np.cos(np.radians(1.0))
    assert abs(support.offset) < 0.06 * support.distance


@pytest.mark.slow
def test_masks_and_plane_of_a_plain_table(plain_scene_of_few_views):
    """The shadow is no part of the ball, and the plane lies where the shadow lies."""
    views, model = plain_scene_of_few_views
    masks, record = find_masks(views, model, 240, seed=0)
    overlaps = []
    for mask, view in zip(masks, views, strict=True):
        truth = ball_mask(view.camera, BALL)
        overlaps.append((mask & truth).sum() / (mask | truth).sum())
    assert np.median(overlaps) > 0.93 and min(overlaps) > 0.85
    assert record["plane_from"] == "views"
    assert abs(record["plane"]["offset"]) < 0.05


@pytest.mark.slow
def test_where_the_color_of_the_table_fails_the_ground_is_told_place_by_place(plain_scene_of_few_views, monkeypatch):
    """As on photos where light from the table gives shaded sides of the object its colour: those masks miss a part of it."""
    views, model = plain_scene_of_few_views
    failures = iter([MasksRejected("the masks miss a part of the object", [], set())])

    def fail_once(*_):
        for failure in failures:
            raise failure

    monkeypatch.setattr(support_plane, "check_points_covered", fail_once)
    masks, record = find_masks(views, model, 240, seed=0)
    truths = [ball_mask(view.camera, BALL) for view in views]
    assert np.median([(mask & truth).sum() / (mask | truth).sum() for mask, truth in zip(masks, truths, strict=True)]) > 0.8
    assert record["without_ground_color"] == "the masks miss a part of the object"


def test_the_flat_top_of_the_object_is_no_support(plain_scene):
    """All points lie on a small lid in the middle: what the object stands on reaches farther."""
    views, model = plain_scene
    rng = np.random.default_rng(0)
    lid = np.column_stack([rng.uniform(-0.4, 0.4, (300, 2)), np.full(300, 0.3)])
    with pytest.raises(StepError, match="no support plane"):
        fit_scene_support(SparseModel(model.cameras, lid, np.zeros((300, 3), np.uint8), np.full(300, 3)), views)


@pytest.mark.slow
def test_a_plane_through_the_things_on_the_table_is_not_taken(plain_scene, carton_scene):
    """Many points at one height, on the object and beside it, but points of the object lie clearly below them."""
    views, model = plain_scene
    rng = np.random.default_rng(0)
    high = np.column_stack([rng.uniform(-1.5, 1.5, (200, 2)), np.full(200, 0.8)])
    points = np.concatenate([model.points[::6], high])
    mixed = SparseModel(model.cameras, points, np.zeros((len(points), 3), np.uint8), np.full(len(points), 3))
    assert abs(fit_scene_support(mixed, views).offset - 0.8) < 0.02
    support, fitted = find_scene_support(mixed, views, seed=0)
    assert not fitted and abs(support.offset) < 0.1 * support.distance
    assert find_scene_support(carton_scene[1], carton_scene[0], seed=0)[1]


def test_the_top_of_a_plate_is_no_ground_where_the_masks_show_it(plain_scene):
    """Most points lie on the print of a plate. The table around it has fewer."""
    views, model = plain_scene
    rng = np.random.default_rng(0)
    plate = np.column_stack([rng.uniform(-1, 1, (1500, 2)), np.full(1500, 0.25)])
    table = rng.uniform(-2, 2, (500, 2))
    table = table[np.abs(table).max(axis=1) > 1.05]
    points = np.concatenate([plate, np.column_stack([table, np.zeros(len(table))])])
    mixed = SparseModel(model.cameras, points, np.zeros((len(points), 3), np.uint8), np.full(len(points), 3))
    top = fit_scene_support(mixed, views)
    assert abs(top.offset - 0.25) < 0.01

    def see_box(half, low, high):
        side = half / 30
        occupied = np.ones((60, 60, round((high - low) / side)), bool)
        return render_silhouettes(VoxelGrid(np.eye(3), np.array([-half, -half, low]), side, occupied.shape), occupied, list(model.cameras))

    below = find_support_below(mixed, views, top, 0, see_box(1.0, 0.0, 0.25))
    assert abs(below.offset) < 0.01 and below.normal @ [0, 0, 1] > np.cos(np.radians(1.0))
    # What stands on the plate alone leaves it the ground; and where there is none below, it stays.
    assert find_support_below(mixed, views, top, 0, see_box(0.4, 0.25, 0.9)) is None
    alone = SparseModel(model.cameras, plate, np.zeros((1500, 3), np.uint8), np.full(1500, 3))
    assert find_support_below(alone, views, top, 0, see_box(1.0, 0.0, 0.25)) is None


def test_a_few_points_on_a_tilted_plane_are_not_taken(plain_scene):
    """The feet of two things and the top of a third give a plane through the table."""
    views, model = plain_scene
    x, y = np.random.default_rng(0).uniform(-1.5, 1.5, (2, 150))
    tilted = np.column_stack([x, y, 0.25 * x])
    mixed = replace(model, points=tilted, colors=np.zeros((150, 3), np.uint8), track_lengths=np.full(150, 3))
    assert fit_scene_support(mixed, views).normal @ [0, 0, 1] < np.cos(np.radians(10))
    support, fitted = find_scene_support(mixed, views, seed=0)
    assert not fitted and support.normal @ [0, 0, 1] > np.cos(np.radians(1.0))


def test_a_small_table_in_a_room_is_found_below_the_thing(plain_scene):
    """Points of the floor, a metre below the table, lie around the foot; those of the thing lie close to each other."""
    views, model = plain_scene
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-1.6, 1.6, (300, 2)), rng.uniform(-1.25, -1.15, 300)])
    points = np.concatenate([model.points, floor])
    room = replace(model, points=points, colors=np.zeros((len(points), 3), np.uint8), track_lengths=np.full(len(points), 3))
    (first, _), (second, fitted) = propose_supports(room, views, seed=0)
    assert abs(first.offset) > 0.2 * first.distance
    assert not fitted and abs(second.offset) < 0.06 * second.distance and np.linalg.norm(second.focus[:2]) < 0.1
    assert len(list(propose_supports(model, views, seed=0))) == 1


def test_windows_lie_around_masks_and_masks_lie_back_in_images(plain_scene):
    views, _ = plain_scene
    masks = [ball_mask(view.camera, BALL) for view in views]
    windows, closer = choose_windows([*masks[:-1], np.zeros_like(masks[-1])])
    assert 0.4 < closer < 0.65
    assert windows[-1].right - windows[-1].left == pytest.approx(windows[0].right - windows[0].left, abs=8)
    cameras, images = cut_views(views, windows, 240)
    for view, mask, window, camera, image in zip(views, masks, windows, cameras, images, strict=True):
        assert np.array_equal(image, view.image()[window.slices].astype(np.float32))
        found = ball_mask(camera, BALL)
        assert np.array_equal(found, mask[window.slices]) and np.array_equal(lay_back(found.astype(np.float32), window, view), mask)
        assert np.array_equal(cut_map(mask.astype(np.float32), window, view, camera) > 0.5, found)


def test_photos_in_portrait_format_are_cut_with_as_many_pixels_as_square_ones(plain_scene):
    views, _ = plain_scene
    height = views[0].camera.height_px
    for width in (height // 2, height):
        (camera,), (image,) = cut_views(views[:1], [Window(0, 0, width, height)], 100)
        assert image.shape == (camera.height_px, camera.width_px, 3)
        assert camera.width_px * camera.height_px == pytest.approx(100 * 100, rel=0.02)
        assert camera.height_px / camera.width_px == pytest.approx(height / width, rel=0.02)


@pytest.mark.slow
def test_a_small_object_is_masked_at_the_images_own_resolution(plain_scene_of_few_views, monkeypatch):
    views, model = plain_scene_of_few_views
    truths = [ball_mask(view.camera, BALL) for view in views]

    def overlap(masks):
        return np.median([(mask & truth).sum() / (mask | truth).sum() for mask, truth in zip(masks, truths, strict=True)])

    look_closer, before = support_plane._look_closer, []

    def keep_what_was_found(found, *rest):
        before.append(found)
        return look_closer(found, *rest)

    monkeypatch.setattr(support_plane, "_look_closer", keep_what_was_found)
    closer, record = find_masks(views, model, 130, seed=0)
    [coarse] = before
    assert record["windows"] < 0.65 and "windows" not in coarse.record
    assert overlap(closer) > overlap(coarse.masks) + 0.05 and overlap(closer) > 0.92


def test_print_is_found_and_edges_are_not():
    image = np.full((120, 160, 3), 200, np.float32)
    image += np.random.default_rng(0).normal(0, 2, image.shape).astype(np.float32)
    image[:, 120:] = 120  # a hard shadow
    image[30:80:6, 30:90] = 60
    found = find_print(image, np.ones((120, 160), bool))
    assert found[34:74, 34:86].all()
    assert not found[:, 110:].any() and not found[:25].any() and not found[86:].any()


def test_too_few_points_tell_no_plane(plain_scene):
    views, model = plain_scene
    few = replace(model, points=model.points[:5], colors=model.colors[:5], track_lengths=model.track_lengths[:5])
    with pytest.raises(StepError, match="5 points were found on what the cameras look at"):
        guess_scene_support(few, views)


@pytest.mark.slow
def test_a_print_is_not_plain(plain_scene, tmp_path):
    for plain in (False, True):
        views, model = table_views(tmp_path / str(plain), [[BALL]] * FEW_VIEWS, plain)
        support = guess_scene_support(plain_scene[1], plain_scene[0])
        cameras, images = cut_views(views, take_whole(views), 240)
        found = fit_plain_ground(build_ground_picture(support, cameras, images), NO_POINTS)
        assert (found is not None) == plain


def test_the_color_of_a_large_flat_thing_is_not_the_tables():
    """A book covers most of what the photos see of the table."""
    cells, side = 300, 0.01
    book, table = (200.0, 160.0, 120.0), (70.0, 70.0, 60.0)
    color = np.full((cells, cells, 3), table, np.float32)
    half = 110
    color[cells // 2 - half : cells // 2 + half, cells // 2 - half : cells // 2 + half] = book
    world_from_cell = np.array([[side, 0, -side * cells / 2], [0, side, -side * cells / 2], [0, 0, 0], [0, 0, 1.0]])
    picture = GroundPicture(color, np.zeros((cells, cells), np.float32), np.ones((cells, cells), bool), world_from_cell)
    on_book = np.column_stack([np.random.default_rng(0).uniform(-half * side, half * side, (2000, 2)), np.full(2000, 0.1)])
    assert fit_plain_ground(picture, NO_POINTS).coefficients[0] == pytest.approx(book, abs=2)
    assert fit_plain_ground(picture, on_book).coefficients[0] == pytest.approx(table, abs=2)


def test_a_shadow_says_little_and_another_hue_much(plain_scene):
    views, model = plain_scene
    support = guess_scene_support(model, views)
    cameras, images = cut_views(views, take_whole(views), 240)
    ground = fit_plain_ground(build_ground_picture(support, cameras, images), NO_POINTS)
    camera = cameras[0]

    def odds_of(color):
        image = np.full((camera.height_px, camera.width_px, 3), color, np.float32)
        return float(np.median(ground.evidence(camera, image)))

    assert odds_of((220, 220, 220)) < -1.4
    assert odds_of((130, 130, 130)) == pytest.approx(SHADOW_ODDS, abs=0.2)
    assert odds_of((20, 20, 20)) > 0.5
    assert odds_of((220, 120, 30)) == pytest.approx(MOST_ODDS, abs=0.1)


def test_agreement_is_no_ground_where_the_hue_is_not_the_tables():
    assert join_odds(np.array([-1.5]), np.array([1.5]))[0] == 1.5
    assert join_odds(np.array([-1.5]), np.array([-0.9]))[0] == -1.5
    assert join_odds(np.array([0.7]), np.array([SHADOW_ODDS]))[0] == pytest.approx(0.7)  # no shadow where the others see a lighter table
    assert join_odds(np.array([0.7]), np.array([-1.5]))[0] == pytest.approx(-0.8)


def test_lonely_points_are_not_on_an_object(plain_scene):
    views, model = plain_scene
    support = guess_scene_support(model, views)
    lonely = np.array([[0.9, 0.9, 0.9]])
    found = find_risen_points(np.concatenate([model.points, lonely]), support)
    assert len(found) > 0.5 * len(model.points) and not (found == lonely).all(axis=1).any()


def test_masks_that_lose_a_part_with_points_are_refused(plain_scene):
    views, model = plain_scene
    cameras = [view.camera for view in views]
    whole = [ball_mask(camera, BALL).astype(np.float32) for camera in cameras]
    check_points_covered(model.points, cameras, whole)
    half = [mask * (np.cumsum(mask.sum(1)) < 0.4 * mask.sum())[:, None] for mask in whole]
    with pytest.raises(MasksRejected, match="miss a part of the object"):
        check_points_covered(model.points, cameras, half)
