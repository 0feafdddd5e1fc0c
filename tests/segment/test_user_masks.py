"""Masks of the user's own are judged like found ones: one that contradicts the others is left out, and too many end the step."""

import cv2
import numpy as np
import pytest

from helpers.made_scene import made_scene
from zeroshop_steps.geometry.cameras.object_crops import fit_object_sphere
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, write_cameras
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import list_images, write_mask
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.surface.rendering.training_views import make_seed_views, read_camera_set

# Whether the cameras of a carton are bent, few rays tell as well.
pytestmark = pytest.mark.usefixtures("few_rays")
COUNT = 12
BITTEN = (1, 6)


@pytest.fixture(scope="module")
def made():
    """A carton's cameras and masks."""
    return made_scene([360.0 / COUNT * number for number in range(COUNT)], [20.0, 45.0] * (COUNT // 2))


@pytest.fixture
def scene(made, tmp_path):
    """A registered scene with masks."""
    folder = tmp_path / "scene"
    made.image_set(folder)
    write_cameras(folder / "sparse", made.cameras)
    write_json(folder / "registration.json", {"status": "ok", "images": COUNT, "registered": COUNT})
    return folder


def given(scene, *more):
    words = ["--scene", scene, "--rejected", scene.parent / "masks.png", "--out", scene.parent / "cameras", *more]
    return stage_main("zeroshop_steps.segment", ["--method", "user_masks", *map(str, words)])


def test_good_masks_are_measured_and_kept(scene):
    assert given(scene) == 0
    record = read_json(scene.parent / "cameras/segmentation.json")
    assert record["method"] == "given" and record["good_masks"] == COUNT and record["dropped"] == {}
    assert record["median_disagreement"] < 0.1
    views, _ = read_views(scene.parent / "cameras")
    doubts = [0.0 if view.confidence() is None else float((view.confidence() < 0.5).sum() / view.mask().sum()) for view in views]
    assert np.mean(doubts) < 0.03


def test_a_mask_of_something_else_is_left_out(scene, made, capsys):
    wrong = np.roll(made.masks[7], 60, 1)
    write_mask(scene / "masks/000007.png", wrong)
    assert given(scene) == 0
    assert "warning: 000007.png is left out" in capsys.readouterr().err
    out = scene.parent / "cameras"
    assert len(list_images(out / "images")) == len(list_images(out / "masks")) == COUNT - 1
    assert len(read_sparse_model(out / "sparse").cameras) == COUNT - 1
    assert read_json(out / "registration.json")["left_out_by_mask"] == ["000007.png"]


def test_a_mask_is_not_sure_where_the_others_contradict_it(scene, made):
    """Two masks lack a part at the carton's top; it is not carved away for them."""
    for index in BITTEN:
        top = np.argwhere(made.masks[index])[0]
        rows, columns = np.indices(made.masks[index].shape)
        write_mask(scene / f"masks/{index:06d}.png", made.masks[index] & (np.hypot(rows - top[0], columns - top[1]) > 12))
    assert given(scene) == 0
    views, model = read_views(scene.parent / "cameras")
    unsure = {view.camera.name for view in views if view.confidence() is not None}
    assert {f"{index:06d}.png" for index in BITTEN} <= unsure
    wrong = [view.mask() != made.masks[index] for index, view in enumerate(views) if index in BITTEN]
    doubted = [view.confidence() < 0.5 for index, view in enumerate(views) if index in BITTEN]
    assert all((doubt & error).sum() > 0.5 * error.sum() for doubt, error in zip(doubted, wrong, strict=True))
    assert sum(doubt.sum() for doubt in doubted) < 2 * sum(error.sum() for error in wrong)  # voxels are coarse in pictures so small
    seeds = make_seed_views(read_camera_set(scene.parent / "cameras"), fit_object_sphere(model.cameras, [view.mask() for view in views]))
    assert seeds[BITTEN[0]].find_possible().sum() > (seeds[BITTEN[0]].mask > 0).sum()


def test_how_the_masks_of_a_capture_were_found_is_kept(scene):
    write_json(
        scene.parent / "capture/segmentation.json", {"method": "support_plane", "things_on_the_ground": 1, "dropped": {"a.png": "empty"}}
    )
    assert given(scene, "--capture", scene.parent / "capture") == 0
    record = read_json(scene.parent / "cameras/segmentation.json")
    assert record["method"] == "support_plane" and record["things_on_the_ground"] == 1 and record["dropped"] == {}


def test_masks_that_contradict_each_other_end_it(scene, made, capsys):
    rng = np.random.default_rng(0)
    for camera, mask in list(zip(made.cameras, made.masks, strict=True))[:7]:
        write_mask(scene / "masks" / camera.name, np.roll(mask, int(rng.integers(40, 150)), 1))
    assert given(scene) == 1
    assert "masks are good" in capsys.readouterr().err and (scene.parent / "masks.png").is_file()
    assert not (scene.parent / "cameras").exists()


@pytest.mark.slow
def test_masks_of_several_sizes_are_judged_alike(scene):
    cameras = []
    for number, camera in enumerate(read_sparse_model(scene / "sparse").cameras):
        if number % 3:
            size = (camera.width_px // 2, camera.height_px // 2) if number % 3 == 1 else (camera.height_px, camera.width_px)
            for part in ("images", "masks"):
                picture = cv2.imread(str(scene / part / camera.name), cv2.IMREAD_UNCHANGED)
                cv2.imwrite(str(scene / part / camera.name), cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST))
            camera = camera.resized(*size)
        cameras.append(camera)
    write_cameras(scene / "sparse", cameras)
    assert given(scene) == 0
    record = read_json(scene.parent / "cameras/segmentation.json")
    assert record["good_masks"] == COUNT and record["median_disagreement"] < 0.1
