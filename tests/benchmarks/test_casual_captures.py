"""Casual captures: their truth is that of the photos, their styles are as hard as they say, and they are made alike again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from casual_captures import home_objects
from casual_captures import scene as casual_scene
from casual_captures import tops as casual_tops
from casual_captures.capture import place_cameras, render_casual_capture
from casual_captures.scene import DIFFICULTIES, HARD_COUNTS, Style, choose_style, lay_scene, mean_color
from helpers.capture_box import box_mesh, write_box
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import compute_overlap, list_images, read_mask
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.synthetic.products.assemble import make_textured_mesh
from zeroshop_steps.synthetic.rendering import lighting
from zeroshop_steps.synthetic.scenes import table_scene
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds

LONG_SIDE_PX = 160
BOUNDS = ObjectBounds(np.zeros(3), 100.0, -50.0)


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """Few texels and samples of light: what is tested here does not depend on them, and they take most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lighting, "SURFACE_CELLS", 24)
        patch.setattr(lighting, "OBJECT_CELLS", 6)
        patch.setattr(table_scene, "TILE_PX", 96)
        patch.setattr(casual_scene, "TILE_PX", 256)
        patch.setattr(casual_tops, "TEXELS", 512)
        yield


@pytest.fixture(scope="module")
def taken(tmp_path_factory) -> Path:
    """A small capture of a box, of the greatest difficulty."""
    folder = tmp_path_factory.mktemp("casual")
    render_casual_capture(write_box(folder / "model"), 3, 1, folder / "capture", LONG_SIDE_PX)
    return folder / "capture"


def test_masks_are_what_the_true_cameras_see_of_the_model(taken: Path) -> None:
    renderer = MeshRenderer(box_mesh())
    cameras = read_sparse_model(taken / "truth").cameras
    assert [camera.name for camera in cameras] == [path.name for path in list_images(taken / "images")]
    for camera in cameras:
        mask = read_mask(taken / "truth/masks" / f"{Path(camera.name).stem}.png", (camera.width_px, camera.height_px))
        assert compute_overlap(mask, renderer.cast_rays(camera).mask) > 0.97
    assert read_json(taken / "truth/truth.json")["height_m"] == 0.1
    assert len(list_images(taken / "held_out/images")) == len(list_images(taken / "held_out/masks"))


def test_the_same_seed_gives_the_same_bytes(taken: Path, tmp_path: Path) -> None:
    model = taken.parent / "model/model.ply"
    render_casual_capture(model, 3, 1, tmp_path / "again", LONG_SIDE_PX)
    files = [path.relative_to(taken) for path in sorted(taken.rglob("*")) if path.is_file()]
    assert len(files) > 20
    for file in files:
        assert (tmp_path / "again" / file).read_bytes() == (taken / file).read_bytes(), file


def test_styles_are_as_hard_as_they_say() -> None:
    for difficulty in DIFFICULTIES:
        styles = [choose_style(difficulty, np.random.default_rng(seed)) for seed in range(40)]
        assert all(len(style.hard) == HARD_COUNTS[difficulty] and 8 <= style.photos <= 14 for style in styles)
        assert all(style.arc_deg == 360.0 or 60.0 <= style.arc_deg <= 150.0 for style in styles)
    assert {name for style in styles for name in style.hard} == set(casual_scene.HARD)


def test_photos_that_cut_off_do_so_in_part() -> None:
    mesh, rng = box_mesh(), np.random.default_rng(0)
    style = Style(("cut_off",), 120.0, 60, "desk", "", "room", False)
    cameras = place_cameras(mesh, BOUNDS, style, 320, rng)
    shown = []
    for camera in cameras:
        pixels, _ = camera.project(mesh.vertices)
        size = np.array([camera.width_px, camera.height_px])
        inside = (np.clip(pixels.max(0), 0, size) - np.clip(pixels.min(0), 0, size)) / (pixels.max(0) - pixels.min(0))
        shown.append(inside.min())
    assert 0.2 < np.mean(np.array(shown) < 0.97) < 0.6
    assert min(shown) > 0.3


def test_a_table_of_the_objects_colour_and_things_that_hide_nothing() -> None:
    mesh, rng = box_mesh(), np.random.default_rng(2)
    style = Style(("crowded", "own_color", "wall"), 100.0, 8, "bare", "", "window", False)
    cameras = place_cameras(mesh, BOUNDS, style, LONG_SIDE_PX, rng)
    scene = lay_scene(mesh, BOUNDS, style, cameras, rng)
    own, table = mean_color(mesh), scene.texture.reshape(-1, 3).mean(0)
    assert np.abs(table / own - 1).max() < 0.2
    assert len(scene.others) >= 3, "a wall and things that stand around"
    view = casual_scene.CasualRenderer(scene)
    for camera in cameras:
        assert compute_overlap(view.render_mask(camera), MeshRenderer(mesh).cast_rays(camera).mask) > 0.9


def test_a_lamp_casts_a_dark_shadow() -> None:
    mesh, rng = box_mesh(), np.random.default_rng(3)
    style = Style(("lamp",), 100.0, 8, "bare", "", "lamp", False)
    cameras = place_cameras(mesh, BOUNDS, style, LONG_SIDE_PX, rng)
    scene = lay_scene(mesh, BOUNDS, style, cameras, rng)
    view = casual_scene.CasualRenderer(replace(scene, others=[]))
    image = view.render(cameras[4]).linear.mean(2)
    ground = image[~view.render_mask(cameras[4])]
    assert np.percentile(ground, 2) < 0.6 * np.percentile(ground, 75)


@pytest.mark.parametrize("name", ["rubber_duck", "thin_figure", "flower_vase", "candlestick"])
def test_home_objects_are_closed_textured_models(name: str, tmp_path: Path) -> None:
    product = home_objects.HOME_OBJECTS[home_objects.list_home_objects().index(name)]()
    mesh = make_textured_mesh(product, 256)
    assert 80 < np.ptp(mesh.vertices, axis=0).max() < 450 and mesh.texture_image.std() > 5
