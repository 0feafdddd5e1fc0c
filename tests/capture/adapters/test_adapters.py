"""Each adapter reads a small folder of its format, written here by true cameras, and bad folders are refused in words."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from helpers.given import given_cameras
from helpers.other_formats import (
    CAMERAS,
    DEPTH_MM,
    NAMES,
    write_bop,
    write_colmap,
    write_colmap_text,
    write_foundationpose,
    write_middlebury,
    write_nerfstudio,
)
from zeroshop_steps.app.command import main
from zeroshop_steps.app.importing import brings_poses, find_source, import_capture
from zeroshop_steps.app.reconstruct_object import Request
from zeroshop_steps.app.workflow import read_chosen_cell
from zeroshop_steps.capture.adapters import find_adapters, recognize
from zeroshop_steps.capture.adapters.form import ImportOptions
from zeroshop_steps.capture.cameras_json import GivenCameras, Lens, read_given_cameras
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.imaging.images import list_images, write_image
from zeroshop_steps.runtime.errors import StepError


def brought(write, folder: Path, **options) -> GivenCameras:
    write(folder / "000005")
    import_capture(folder / "000005", folder / "ours", ImportOptions(**options))
    return read_given_cameras(folder / "ours/cameras.json")


@pytest.mark.parametrize(
    ("write", "options"),
    [
        (write_colmap, {"unit": "mm"}),
        (write_colmap_text, {"unit": "mm"}),
        (write_nerfstudio, {"unit": "m"}),
        (write_bop, {"object_id": 5}),
        (write_middlebury, {}),
    ],
)
def test_cameras_of_every_format_are_the_true_ones_in_metres(write, options, tmp_path):
    given, truth = brought(write, tmp_path, **options), given_cameras(CAMERAS)
    assert given.metric and list(given.images) == NAMES
    for name in NAMES:
        assert np.allclose(given.images[name].camera_from_world, truth.images[name].camera_from_world, atol=1e-6)
        assert np.allclose(given.images[name].lens.params, truth.images[name].lens.params) and given.images[name].lens.model == "PINHOLE"
        assert (tmp_path / "ours/images" / name).read_bytes()
    assert len([adapter for adapter in find_adapters() if adapter.recognizes(tmp_path / "000005")]) == 1


def test_units_that_no_format_says_stay_unknown(tmp_path, capsys):
    assert not brought(write_nerfstudio, tmp_path).metric
    assert "does not say its unit" in capsys.readouterr().err


@pytest.mark.parametrize(("write", "options"), [(write_nerfstudio, {}), (write_bop, {"object_id": 5})])
def test_depth_and_the_objects_masks_come_along(write, options, tmp_path):
    given = brought(write, tmp_path, **options)
    depth = cv2.imread(str(tmp_path / "ours/depth/000000.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16 and np.allclose(depth * given.depth_step_mm, DEPTH_MM, atol=given.depth_step_mm)
    mask = cv2.imread(str(tmp_path / "ours/masks/000000.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(mask > 0, np.eye(120, 160, k=1 if write is write_bop else 0, dtype=bool))


def test_a_bop_scene_of_several_objects_asks_which(tmp_path):
    write_bop(tmp_path / "000005")
    for wanted, said in ((None, r"several objects: 2 \(8 images\), 5 \(8 images\); choose one"), (7, "does not show the object 7")):
        with pytest.raises(StepError, match=said):
            import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions(object_id=wanted))


def test_foundationposes_folder_brings_depth_but_no_poses(tmp_path):
    write_foundationpose(tmp_path / "000005")
    source = find_source(tmp_path / "000005", tmp_path, "box")
    given = read_given_cameras(source.images.parent / "cameras.json")
    assert not given.poses and not source.poses and source.height_method == "depth_camera" and source.masks
    assert source.cameras and not brings_poses(source.cameras), "its lenses are known"
    assert given.images["000000.png"].lens == Lens("PINHOLE", 160, 120, (300.0, 300.0, 80.0, 60.0))


@pytest.mark.parametrize("name", ["obj_000005_up", "obj_000005_down", "obj_000005"])
def test_bops_onboarding_sequences_are_read_by_their_names(name, tmp_path):
    write_bop(tmp_path / name)
    import_capture(tmp_path / name, tmp_path / "ours", ImportOptions(object_id=5))
    assert len(read_given_cameras(tmp_path / "ours/cameras.json").poses) == len(NAMES)


def test_a_real_foundationpose_folder_is_recognized(shared_data):
    assert recognize(shared_data / "captures/granola_rgbd").title == "a FoundationPose folder"


def test_real_cameras_of_a_colmap_project_are_read(shared_data, tmp_path):
    """DTU's scan 65, calibrated in millimetres."""
    import_capture(shared_data / "dtu_scan65", tmp_path / "ours", ImportOptions("mm"))
    given = read_given_cameras(tmp_path / "ours/cameras.json")
    model = read_reconstruction(shared_data / "dtu_scan65/sparse/0")
    for image in model.images.values():
        assert np.allclose(given.poses[Path(image.name).stem + ".jpg"][:3, 3], image.cam_from_world().translation / 1000, atol=1e-9)
    assert len(given.poses) == 25 and len(list((tmp_path / "ours/masks").iterdir())) == 25


def of_transforms(folder: Path, change) -> None:
    content = json.loads((folder / "transforms.json").read_text())
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda content: content["frames"][1].update(file_path="/home/lab/mug/1.png"), "absolute path, of the machine that wrote it"),
        (lambda content: content["frames"][1].update(file_path="C:\\mug\\1.png"), "absolute path"),
        (lambda content: content["frames"][1].update(file_path="../../etc/1.png"), "leads out of"),
        (lambda content: content["frames"][1].update(file_path="images/none.png"), "8 images, 1 of them are missing.*none.png"),
        (lambda content: content["frames"][1].update(depth_file_path="none.npy"), "missing"),
        (lambda content: content["frames"][1].pop("transform_matrix"), "no transform_matrix"),
        (lambda content: content.pop("fl_x"), "has no lens"),
        (lambda content: content.update(camera_model="EQUIRECTANGULAR"), "no lens of an object's photo"),
        (lambda content: content.pop("frames"), "lists no frames"),
        (
            lambda content: [one["transform_matrix"][0].__setitem__(3, float("nan")) for one in content["frames"][:4]],
            "4 of 8 poses hold NaN",
        ),
        (lambda content: [row.__setitem__(0, -row[0]) for row in content["frames"][1]["transform_matrix"][:3]], "left-handed"),
        (lambda content: content.update(w=120, h=160), "turned or cropped"),
        (lambda content: content.update(depth_unit_scale_factor="mm"), "depth_unit_scale_factor is 'mm'; expected metres"),
        (lambda content: content.update(depth_unit_scale_factor=None), "depth_unit_scale_factor is None; expected metres"),
        (lambda content: content.pop("depth_unit_scale_factor"), "at 1 mm a step, is 0.4 mm in the median"),
        (
            lambda content: content.update(depth_unit_scale_factor=1000.0),
            "is 4e.05 mm in the median.*it looks like millimetres, taken for metres",
        ),
    ],
)
def test_a_bad_transforms_json_is_refused_in_words(change, said, tmp_path):
    write_nerfstudio(tmp_path / "000005")
    of_transforms(tmp_path / "000005", change)
    with pytest.raises(StepError, match=said):
        import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions())
    assert not (tmp_path / "ours").exists()


def test_a_link_that_leads_out_of_the_folder_is_not_followed(tmp_path):
    write_nerfstudio(tmp_path / "000005")
    shutil.move(tmp_path / "000005/images", tmp_path / "elsewhere")
    (tmp_path / "000005/images").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StepError, match="not followed"):
        import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda path: write_image(path, np.zeros((60, 80), np.uint16)), "aligned to the colour image"),
        (lambda path: write_image(path, np.zeros((120, 160), np.uint8)), "8 bits"),
    ],
)
def test_depth_that_is_no_depth_is_refused(change, said, tmp_path):
    write_bop(tmp_path / "000005")
    change(tmp_path / "000005/depth/000003.png")
    with pytest.raises(StepError, match=said):
        import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions(object_id=5))


def test_lines_of_middlebury_with_missing_numbers_or_images_are_named(tmp_path):
    write_middlebury(tmp_path)
    (tmp_path / NAMES[2]).unlink()
    with pytest.raises(StepError, match=f"1 of them are missing.*{NAMES[2]}"):
        import_capture(tmp_path, tmp_path.with_name("ours"), ImportOptions())
    (tmp_path / "temple_par.txt").write_text(f"1\n{NAMES[0]} 1 2 3\n")
    with pytest.raises(StepError, match="3 numbers; expected 21"):
        import_capture(tmp_path, tmp_path.with_name("ours"), ImportOptions())


def test_a_matrix_of_images_of_another_size_is_told(tmp_path, capsys):
    write_foundationpose(tmp_path / "000005")
    import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions())
    assert "centre of a lens" not in capsys.readouterr().err
    path = tmp_path / "000005/cam_K.txt"
    np.savetxt(path, np.loadtxt(path) * [[2], [2], [1]])
    import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions())
    assert "lies at (160, 120) in images of 160 x 120 px: if they were not cropped" in capsys.readouterr().err


def test_a_model_that_colmap_distorted_keeps_its_lens(tmp_path):
    write_colmap(tmp_path / "000005")
    model = read_reconstruction(tmp_path / "000005/sparse/0")
    for camera in model.cameras.values():
        camera.model, camera.params = pycolmap.CameraModelId.SIMPLE_RADIAL, [300.0, 80.0, 60.0, -0.1]
    model.write_binary(str(tmp_path / "000005/sparse/0"))
    import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions())
    given = read_given_cameras(tmp_path / "ours/cameras.json")
    assert given.images[NAMES[0]].lens == Lens("SIMPLE_RADIAL", 160, 120, (300.0, 80.0, 60.0, -0.1)) and not given.metric


def test_what_is_nothing_known_is_refused_with_the_list(tmp_path):
    (tmp_path / "000005").mkdir()
    (tmp_path / "000005/notes.txt").write_text("nothing")
    for ask in (
        lambda: import_capture(tmp_path / "000005", tmp_path / "ours", ImportOptions()),
        lambda: find_source(tmp_path / "000005", tmp_path, "x"),
    ):
        with pytest.raises(StepError, match="Known are: a folder of photos; a film; the common form.*BOP.*transforms.json.*COLMAP"):
            ask()


def test_an_import_is_not_repeated_while_nothing_changed(tmp_path, capsys):
    write_middlebury(tmp_path / "000005")
    first = find_source(tmp_path / "000005", tmp_path, "temple")
    time_ns = first.images.stat().st_mtime_ns
    assert find_source(tmp_path / "000005", tmp_path, "temple") == first and first.images.stat().st_mtime_ns == time_ns
    assert "is Middlebury's multi-view data" in capsys.readouterr().err
    (tmp_path / "000005" / NAMES[0]).touch()
    assert find_source(tmp_path / "000005", tmp_path, "temple") == first and first.images.stat().st_mtime_ns > time_ns


def test_nothing_else_is_written_over(tmp_path):
    write_middlebury(tmp_path / "000005")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("dear")
    for out in (tmp_path / "mine", tmp_path / "000005", tmp_path):
        with pytest.raises(StepError, match="holds"):
            import_capture(tmp_path / "000005", out, ImportOptions())


def test_the_command_writes_the_common_form_and_a_mesh_is_asked_of_it(tmp_path, capsys):
    """`zeroshop import`, and the row of the table that `zeroshop` makes of what it wrote."""
    write_nerfstudio(tmp_path / "theirs")
    words = ["import", tmp_path / "theirs", "--out", tmp_path / "mug", "--unit", "m", "--position-deviation", "0.001"]
    assert main([str(word) for word in words]) == 0
    assert "is nerfstudio's or instant-ngp's folder" in capsys.readouterr().out
    row = Request([tmp_path / "mug"], into=tmp_path).capture()
    assert (row.object, row.images, row.cameras) == ("mug", str(tmp_path / "mug/images"), str(tmp_path / "mug/cameras.json"))
    assert row.masks == str(tmp_path / "mug/masks") and row.height_method == "" and row.depth == str(tmp_path / "mug/depth")
    assert read_given_cameras(tmp_path / "mug/cameras.json").position_deviation_m == 0.001
    with pytest.raises(StepError, match="mug brings the poses of its cameras, and .*images does not; give captures that all bring them"):
        Request([tmp_path / "mug", tmp_path / "theirs/images"], into=tmp_path).capture()
    row = Request([tmp_path / "mug", tmp_path / "theirs"], into=tmp_path).capture()
    second = tmp_path / "results/imported/mug.2"
    assert (row.images, row.images_2, row.cameras_2) == (str(tmp_path / "mug/images"), f"{second}/images", f"{second}/cameras.json")
    assert (row.masks_2, row.depth_2) == (f"{second}/masks", f"{second}/depth")
    assert main(["import", str(tmp_path / "theirs/masks"), "--out", str(tmp_path / "other")]) == 1
    assert "nothing that can be imported" in capsys.readouterr().err


def test_a_check_judges_the_photos_of_other_programs(tmp_path, capsys, monkeypatch):
    """They are imported to a folder that is gone afterwards."""
    write_nerfstudio(tmp_path / "theirs")
    judged = []
    monkeypatch.setattr(
        "zeroshop_steps.app.check.check_capture", lambda source: judged.append((source, len(list_images(source)))) or ([], [])
    )
    monkeypatch.chdir(tmp_path)
    assert main(["check", "theirs"]) == 0 and "ready" in capsys.readouterr().out
    [(folder, count)] = judged
    assert count == len(list_images(tmp_path / "theirs/images")) and not folder.exists() and not (tmp_path / "results").exists()


def test_cells_of_given_cameras_lie_where_the_workflow_puts_them():
    assert read_chosen_cell({}, given_cameras=True) == ("video", "given") != read_chosen_cell({})
