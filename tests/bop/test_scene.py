"""Scenes, targets and models: what is written reads back, and bad input is named."""

import json
import shutil

import numpy as np
import pytest

from helpers.small_dataset import BOX, CAN, HEIGHT_PX, WIDTH_PX, dataset_in
from zeroshop_steps.bop.formats.bop_scenes import read_scene, write_scene
from zeroshop_steps.bop.formats.models import model_path, read_models
from zeroshop_steps.bop.formats.targets import read_target_frames, read_targets
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.errors import StepError


def changed(path, change):
    """Rewrite a JSON file after `change(content)`."""
    content = json.loads(path.read_text())
    path.write_text(json.dumps(change(content) or content))


def test_a_scene_reads_back_as_it_was_written(dataset, tmp_path):
    frames = read_scene(dataset.scenes / "000001")
    write_scene(tmp_path / "000007", list(frames.values()))
    again = read_scene(tmp_path / "000007")
    assert list(again) == list(frames) == [0, 1]
    for one, other in zip(frames.values(), again.values(), strict=True):
        assert other.scene_id == 7 and one.depth_scale == other.depth_scale == 0.1
        np.testing.assert_array_equal(one.intrinsics, other.intrinsics)
        for left, right in zip(one.instances, other.instances, strict=True):
            np.testing.assert_array_equal(left.camera_from_model, right.camera_from_model)
            assert left.info == right.info and left.object_id == right.object_id


def test_pictures_agree_with_the_annotations(dataset):
    frame = dataset.frames[1, 1]
    assert frame.size_px() == (WIDTH_PX, HEIGHT_PX)
    assert frame.depth_mm().max() == pytest.approx(650, abs=0.05)
    for index, instance in enumerate(frame.instances):
        visible, whole = frame.mask(index), frame.mask(index, "mask")
        assert visible.sum() == instance.info["px_count_visib"] and (visible & ~whole).sum() == 0
        assert whole.sum() <= instance.info["px_count_all"]
        x, y, width, height = instance.info["bbox_visib"]
        assert visible[y : y + height + 1, x : x + width + 1].sum() == visible.sum()


def test_the_projects_camera_sees_what_bops_matrix_sees(dataset):
    frame = dataset.frames[1, 0]
    point = frame.instances[0].camera_from_model[:3, 3]
    pixels, _ = frame.camera(WIDTH_PX, HEIGHT_PX).project(point[None])
    projected = frame.intrinsics @ point
    np.testing.assert_allclose(pixels[0], projected[:2] / projected[2] + 0.5)


BAD_SCENES = {
    "metres": (
        "scene_gt.json",
        lambda c: [e.update(cam_t_m2c=[v / 1000 for v in e["cam_t_m2c"]]) for i in c.values() for e in i],
        "metres",
    ),
    "no rotation": (
        "scene_gt.json",
        lambda c: c["0"][1].update(cam_R_m2c=[2, 0, 0, 0, 1, 0, 0, 0, 1]),
        "image 0, instance 1: R is no rotation",
    ),
    "mirror": ("scene_gt.json", lambda c: c["0"][0].update(cam_R_m2c=[-1, 0, 0, 0, 1, 0, 0, 0, 1]), "mirrors"),
    "nan": ("scene_gt.json", lambda c: c["1"][0].update(cam_t_m2c=[0, float("nan"), 500]), "nan is not a finite number"),
    "short": ("scene_gt.json", lambda c: c["1"][0].update(cam_t_m2c=[0, 500]), "at 1 / 0 / cam_t_m2c"),
    "no object": ("scene_gt.json", lambda c: c["1"][0].pop("obj_id"), "'obj_id' is a required property"),
    "depth scale": ("scene_camera.json", lambda c: c["1"].update(depth_scale=0), "depth_scale of image 1 is 0"),
    "no camera": ("scene_camera.json", lambda c: c.pop("1"), "lacks image 1"),
    "no focal length": ("scene_camera.json", lambda c: c["0"].update(cam_K=[0] * 9), "focal lengths"),
    "fewer infos": ("scene_gt_info.json", lambda c: c["1"].pop(), "the two files must list the same"),
    "visibility": ("scene_gt_info.json", lambda c: c["1"][0].update(visib_fract=3), "maximum"),
}


@pytest.mark.parametrize("name", BAD_SCENES)
def test_a_bad_scene_is_refused(dataset, name):
    file, change, message = BAD_SCENES[name]
    changed(dataset.scenes / "000001" / file, lambda content: change(content) and None)
    with pytest.raises(StepError, match=message) as error:
        read_scene(dataset.scenes / "000001")
    assert file in str(error.value)


def test_zeros_before_numbers_points_behind_them_and_rows_of_matrices_do_not_matter(dataset):
    def as_others(content):
        for entry in [one for found in content.values() for one in (found if isinstance(found, list) else [found])]:
            for key in {"cam_K", "cam_R_m2c"} & set(entry):
                entry[key] = np.reshape(entry[key], (3, 3)).tolist()
            entry |= {"obj_id": float(entry["obj_id"])} if "obj_id" in entry else {}
        return {f"{int(number):06d}": found for number, found in content.items()}

    for name in ("scene_camera.json", "scene_gt.json"):
        path = dataset.scenes / "000001" / name
        changed(path, as_others)
        path.write_text(path.read_text(), encoding="utf-8-sig")
    for path in sorted((dataset.scenes / "000001").glob("*/*.png")):
        path.rename(path.with_stem("_".join(str(int(number)) for number in path.stem.split("_"))))
    frame, before = dataset_in(dataset.folder).frames[1, 1], dataset.frames[1, 1]
    np.testing.assert_array_equal(frame.intrinsics, before.intrinsics)
    np.testing.assert_array_equal(frame.instances[2].camera_from_model, before.instances[2].camera_from_model)
    assert (frame.mask(2).sum(), frame.has_depth) == (frame.instances[2].info["px_count_visib"], True)


def test_missing_depth_is_named(dataset):
    shutil.rmtree(dataset.scenes / "000001" / "depth")
    with pytest.raises(StepError, match="has no image 000000 .* leave vsd out"):
        dataset_in(dataset.folder).frames[1, 0].depth_mm()


def test_a_link_that_was_copied_as_text_is_named(dataset):
    shutil.rmtree(dataset.scenes / "000001" / "depth")
    (dataset.scenes / "000001" / "depth").write_text("/data/test/000001/depth")
    with pytest.raises(StepError, match=r"000001/depth is a file, not a folder of images, .*; put the folder there"):
        dataset_in(dataset.folder).frames[1, 0].image_path("depth")


def test_a_missing_mask_is_named(dataset):
    shutil.rmtree(dataset.scenes / "000001" / "mask_visib")
    with pytest.raises(StepError, match="mask_visib has no 000000_000000.png"):
        dataset.frames[1, 0].mask(0)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"scene_id": 9, "im_id": 0, "obj_id": 1, "inst_count": 1}, "scene 9"),
        ({"scene_id": 1, "im_id": 44, "obj_id": 1, "inst_count": 1}, "image 44 of scene 1"),
        ({"scene_id": 1, "im_id": 0, "obj_id": BOX, "inst_count": 2}, "asks for"),
        ({"scene_id": 1, "im_id": 1, "obj_id": BOX, "inst_count": 3}, "asks for"),
        ({"scene_id": 1, "im_id": 1, "obj_id": BOX}, "'inst_count' is a dependency of 'obj_id'"),
    ],
)
def test_targets_without_images_are_refused(dataset, entry, message):
    keep = [] if entry["im_id"] != 44 else json.loads(dataset.targets_path.read_text())
    dataset.targets_path.write_text(json.dumps([*keep, entry]))
    with pytest.raises(StepError, match=message):
        read_target_frames(dataset.scenes, read_targets(dataset.targets_path), dataset.targets_path)


def test_models_are_checked(dataset, tmp_path):
    folder = dataset.folder / "models"
    models = read_models(folder, [BOX, CAN, BOX])
    assert list(models) == [BOX, CAN] and len(models[BOX].symmetries) == 1 and len(models[CAN].symmetries) == 315
    with pytest.raises(StepError, match=r"object 9 has no model .* it has the objects \[1, 2\]"):
        read_models(folder, [9])
    mesh = read_ply(model_path(folder, BOX))
    write_ply(model_path(folder, BOX), Mesh(mesh.vertices / 1000, mesh.faces))
    with pytest.raises(StepError, match="Convert it to millimetres"):
        read_models(folder, [BOX])
    write_ply(model_path(folder, BOX), Mesh(mesh.vertices * 1.2, mesh.faces))
    with pytest.raises(StepError, match="do not belong together"):
        read_models(folder, [BOX])
