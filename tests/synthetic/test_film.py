"""A rendered film: a video that can be taken frames from, on a table whose clutter hides nothing, with masks that are true."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from helpers.capture_box import box_mesh, write_box
from zeroshop_steps.capture.video import extract_frames
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import list_images, read_mask
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.synthetic.board_scene import BOARD, place_empty_cameras
from zeroshop_steps.synthetic.film import render_film
from zeroshop_steps.synthetic.rendering import lighting
from zeroshop_steps.synthetic.scenes import table_scene, table_tops
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds
from zeroshop_steps.synthetic.scenes.film_scene import BOARD_GAP_MM, CLEAR_VIEW_DEG, LEAST_GAP_MM, FilmRenderer, lay_table
from zeroshop_steps.synthetic.scenes.handheld_camera import DURATION_S, ELEVATIONS_DEG, FilmLens, HandheldCamera

SIZE_PX = (320, 180)
FRAMES = 20
SUBJECT = ObjectBounds(np.zeros(3), 100.0, -50.0)


@pytest.fixture(scope="module", autouse=True)
def coarse_table():
    """A table with fewer texels and samples of light: what is tested here does not depend on them, and they take most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lighting, "SURFACE_CELLS", 24)
        print_ = table_tops.TABLE_TOPS["print"]
        coarse = replace(print_, make_texture=partial(print_.make_texture, texels=1024))
        patch.setitem(table_tops.TABLE_TOPS, "print", coarse)
        patch.setattr(table_scene, "TILE_PX", 96)
        yield


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A small film of a box beside the board."""
    folder = tmp_path_factory.mktemp("film")
    render_film(write_box(folder / "model"), True, 3, folder / "film", SIZE_PX, FRAMES)
    return folder / "film"


@pytest.mark.slow
def test_the_film_is_a_video_that_frames_are_taken_from(filmed, tmp_path):
    extract_frames(filmed / "film.mp4", 8, 1920, tmp_path / "capture")
    assert len(list_images(tmp_path / "capture" / "images")) >= 7
    record = read_json(tmp_path / "capture" / "capture.json")
    assert (record["width_px"], record["height_px"], record["video_frames"]) == (*SIZE_PX, FRAMES)


@pytest.mark.slow
def test_the_truth_covers_every_frame(filmed):
    cameras = read_sparse_model(filmed / "truth" / "cameras").cameras
    masks = [read_mask(path) for path in list_images(filmed / "truth" / "masks")]
    assert len(cameras) == len(masks) == FRAMES
    assert read_json(filmed / "truth" / "truth.json")["height_m"] == 0.1
    for camera, mask in zip(cameras, masks, strict=True):
        pixels, _ = camera.project(box_mesh().vertices)
        hull = cv2.fillConvexPoly(np.zeros(mask.shape, np.uint8), cv2.convexHull(np.rint(pixels - 0.5).astype(np.int32)), 1) > 0
        assert (mask & hull).sum() > 0.97 * (mask | hull).sum() - 0.5 * np.hypot(*mask.shape)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_and_another_one_another_table(tmp_path, monkeypatch):
    model = write_box(tmp_path / "model")
    print_ = table_tops.TABLE_TOPS["print"]
    monkeypatch.setitem(table_tops.TABLE_TOPS, "print", replace(print_, things=2, make_texture=partial(print_.make_texture, texels=256)))
    for name, seed in (("one", 3), ("again", 3), ("other", 4)):
        render_film(model, False, seed, tmp_path / name, (160, 90), 3)
    one, again, other = ((tmp_path / name / "film.mp4").read_bytes() for name in ("one", "again", "other"))
    assert one == again and one != other


@pytest.mark.slow
def test_the_board_lies_in_the_empty_scene_and_the_object_does_not(monkeypatch):
    mesh = box_mesh()
    monkeypatch.setitem(table_tops.TABLE_TOPS, "print", replace(table_tops.TABLE_TOPS["print"], things=2))
    table = lay_table(mesh, SUBJECT, 0, np.random.default_rng(0))
    view = FilmRenderer(table, with_object=False, with_board=True)
    camera = place_empty_cameras(mesh, table.bounds, *SIZE_PX, 30.0, BOARD_GAP_MM)[0]
    squares = [(column, row) for column in range(BOARD.columns) for row in range(BOARD.rows)]
    middles = np.array([[(c + 0.5) * BOARD.square_mm, (r + 0.5) * BOARD.square_mm, 0, 1] for c, r in squares]) @ table.board_pose.T
    x, y = camera.project(middles[:, :3])[0].astype(int).T
    corner = camera.project((middles + (table.board_pose @ [0.46 * BOARD.square_mm, 0, 0, 0]))[:, :3])[0].astype(int).T
    levels = view.render(camera).mean(2)
    black = np.array([(column + row) % 2 == 0 for column, row in squares])
    assert levels[y, x][black].max() < 0.5 * levels[corner[1], corner[0]][~black].mean()
    assert not view.render_mask(camera).any()


@pytest.mark.slow
def test_a_glossy_table_mirrors_the_object_and_a_matt_one_does_not(monkeypatch):
    """What lies below the object in the picture gets its colours."""
    monkeypatch.setattr(table_tops, "TEXTURE_PX", 64)
    mesh = box_mesh()
    below = {}
    for top in ("glossy", "white"):
        table = lay_table(mesh, SUBJECT, 0, np.random.default_rng(0), top)
        assert len(table.clutter) <= table.top.things
        camera = place_empty_cameras(mesh, table.bounds, *SIZE_PX, 30.0, BOARD_GAP_MM)[0]
        plain = FilmRenderer(replace(table, top=replace(table.top, mirror=0.0)), with_object=True, with_board=False)
        mirrored = FilmRenderer(table, with_object=True, with_board=False)
        change = np.abs(mirrored.render(camera) - plain.render(camera)).max(2)
        mask = mirrored.render_mask(camera)
        inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5))) > 0
        assert change[inner].max() == 0
        below[top] = change[~mask].max()
    assert below["glossy"] > 0.01 and below["white"] == 0


@pytest.mark.parametrize("name", [name for name in table_tops.TABLE_TOPS if name != "print"])
def test_a_plain_top_shows_little_print(name):
    texture = table_tops.TABLE_TOPS[name].make_texture(np.random.default_rng(0))
    assert texture.shape == (table_tops.TEXTURE_PX, table_tops.TEXTURE_PX, 3) and texture.dtype == np.uint8
    light = texture.mean(2)
    assert light.std() < 0.15 * light.mean() + 2


def test_the_hand_goes_around_twice_in_two_heights_and_is_never_still():
    hand = HandheldCamera(SUBJECT, 120.0, FilmLens(*SIZE_PX), np.random.default_rng(0))
    centres = np.array([hand.camera_at(time, "").centre_in_world for time in np.linspace(0, DURATION_S, 200)])
    azimuth = np.unwrap(np.arctan2(centres[:, 1], centres[:, 0]))
    assert azimuth[0] == pytest.approx(0, abs=0.2) and azimuth[-1] - azimuth[0] == pytest.approx(4 * np.pi, abs=0.5)
    elevation = np.degrees(np.arcsin(centres[:, 2] / np.linalg.norm(centres, axis=1)))
    assert abs(elevation[:80].mean() - ELEVATIONS_DEG[0]) < 5 and abs(elevation[120:].mean() - ELEVATIONS_DEG[1]) < 5
    turned = [
        np.linalg.norm(np.diff([hand.camera_at(t + dt, "").camera_from_world[2, :3] for dt in (0, 0.02)], axis=0)) for t in range(0, 40)
    ]
    assert min(turned) > 1e-5 and max(turned) < 0.05


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_clutter_keeps_apart_and_low_enough_to_hide_nothing(seed):
    things = lay_table(box_mesh(), SUBJECT, seed, np.random.default_rng(seed)).clutter
    assert len(things) >= 3
    for thing in things:
        gap_mm = np.linalg.norm(np.maximum(np.abs(thing.vertices[:, :2]) - [20, 30], 0), axis=1).min()
        tall_mm = thing.vertices[:, 2].max() + 50
        assert gap_mm > max(LEAST_GAP_MM, tall_mm / np.tan(np.radians(CLEAR_VIEW_DEG))) - 1.5
        assert thing.vertices[:, 2].min() == pytest.approx(-50, abs=0.5)
