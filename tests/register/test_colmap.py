"""Registration with COLMAP on a small virtual capture with true cameras."""

import filecmp
import shutil

import numpy as np
import pycolmap
import pytest
from PIL import Image

from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import read_deviations
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask
from zeroshop_steps.register import colmap
from zeroshop_steps.register.features.sift import SiftOptions, extract_features, find_focal_source, refine
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import TooFewRegistered
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import read_json

FEWER = ("--max-features", 1000)


def register(*words) -> int:
    return stage_main("zeroshop_steps.register", [str(word) for word in words])


@pytest.fixture(scope="module")
def registered(carton_capture, tmp_path_factory):
    out = tmp_path_factory.mktemp("colmap") / "cameras"
    assert register("--method", "colmap", "--capture", carton_capture, "--scene", "su_h", "--out", out, *FEWER) == 0
    return out


@pytest.mark.slow
def test_cameras_are_right(registered, carton_capture):
    error = compare_cameras(read_sparse_model(registered / "sparse").cameras, read_sparse_model(carton_capture / "truth").cameras)
    assert len(error.names) == 10
    assert error.centre_mm.mean() < 0.5
    assert error.rotation_deg.max() < 0.1


@pytest.mark.slow
def test_folder_is_complete_and_consistent(registered):
    model = read_sparse_model(registered / "sparse")
    record = read_json(registered / "registration.json")
    assert record["status"] == "ok" and record["registered"] == 10 and record["reprojection_error_px"] < 1.0
    assert record["points"] == len(model.points) > 200
    assert list(read_deviations(registered)) == [camera.name for camera in model.cameras] and record["deviation_px"]["largest"] < 0.5
    assert [path.name for path in list_images(registered / "images")] == [camera.name for camera in model.cameras]
    for camera in model.cameras:
        assert read_image(registered / "images" / camera.name).shape == (camera.height_px, camera.width_px, 3)
        mask = read_mask(registered / "masks" / camera.name, (camera.width_px, camera.height_px))
        # The points inside the silhouettes are the object's: they start the surface, so there must be some in every view.
        pixels, depth = camera.project(model.points)
        columns, rows = np.floor(pixels).astype(int).T
        seen = (depth > 0) & (columns >= 0) & (rows >= 0) & (columns < camera.width_px) & (rows < camera.height_px)
        assert mask[rows[seen], columns[seen]].sum() > 20


@pytest.mark.slow
def test_same_input_gives_the_same_bytes(registered, carton_capture, tmp_path):
    assert register("--method", "colmap", "--capture", carton_capture, "--scene", "su_h", "--out", tmp_path / "again", *FEWER) == 0
    files = [path.relative_to(registered) for path in sorted(registered.rglob("*")) if path.is_file() and path.suffix != ".json"]
    assert len(files) >= 23
    for file in files:
        assert filecmp.cmp(registered / file, tmp_path / "again" / file, shallow=False), file


def test_images_without_texture_fail_with_a_reason(blank_capture, tmp_path, capsys):
    out = tmp_path / "cell" / "cameras"
    assert register("--method", "colmap", "--capture", blank_capture, "--scene", "su_h", "--out", out) == 1
    assert "0 of 10 images registered, at least 8 are needed" in capsys.readouterr().err
    assert list(out.parent.iterdir()) == []


def test_a_failure_is_a_result_where_it_may_be_recorded(blank_capture, tmp_path):
    out = tmp_path / "cell" / "cameras"
    words = ("--method", "colmap", "--capture", blank_capture, "--scene", "su_h", "--out", out, "--record-failure", f"{out}/")
    assert register(*words) == 0
    assert "0 of 10 images" in read_failure(out).reason
    record = read_json(out / "registration.json")
    assert record["status"] == "failed" and "0 of 10 images" in record["reason"]
    assert {path.name for path in out.iterdir()} == {"failure.json", "registration.json"}


@pytest.mark.parametrize("damage", ["two images", "no mask", "empty mask", "damaged image", "alike", "small mask"])
def test_bad_captures_are_refused_by_name(blank_capture, tmp_path, capsys, damage):
    images, masks = list_images(blank_capture / "images"), list_images(blank_capture / "masks")
    if damage == "two images":
        for path in images[2:]:
            path.unlink()
    elif damage == "no mask":
        masks[3].unlink()
    elif damage == "empty mask":
        from zeroshop_steps.geometry.imaging.images import write_mask

        write_mask(masks[3], np.zeros((120, 160), bool))
    elif damage == "small mask":
        from zeroshop_steps.geometry.imaging.images import write_mask

        write_mask(masks[3], np.ones((12, 16), bool))
    elif damage == "damaged image":
        images[3].write_bytes(images[3].read_bytes()[:60])
    else:
        for path in images[1:]:
            shutil.copy(images[0], path)
    out = tmp_path / "cell" / "cameras"
    assert register("--method", "colmap", "--capture", blank_capture, "--scene", "su_h", "--out", out) == 1
    message = capsys.readouterr().err
    expected = {"two images": "holds 2 image(s)", "alike": "are alike"}.get(damage, "000003.png")
    assert expected in message
    assert not out.exists()


@pytest.mark.parametrize(("focal_35mm", "source"), [(50, "exif"), (None, "estimated")])
def test_the_mapper_starts_from_the_focal_length_in_exif(tmp_path, focal_35mm, source):
    (tmp_path / "images").mkdir()
    for number in range(3):
        pixels = np.random.default_rng(number).integers(0, 255, (24, 32, 3), dtype=np.uint8)
        photo = Image.fromarray(pixels).resize((640, 480), Image.Resampling.NEAREST)
        exif = photo.getexif()
        if focal_35mm:
            exif.get_ifd(0x8769)[0xA405] = focal_35mm
        photo.save(tmp_path / f"images/{number:06d}.jpg", exif=exif)
    extract_features(tmp_path / "database.db", read_image_set(tmp_path), SiftOptions(max_features=300))
    assert find_focal_source(tmp_path / "database.db") == source
    with pycolmap.Database.open(tmp_path / "database.db") as opened:
        (camera,) = opened.read_all_cameras()
    assert camera.mean_focal_length() == pytest.approx(focal_35mm / 36 * 640 if focal_35mm else 1.2 * 640, rel=0.04)


def test_where_too_few_images_match_finer_features_are_tried(tmp_path, monkeypatch):
    """Photos that overlap little: what the coarse features leave apart, those at twice the resolution may join."""
    image_set = ImageSet(tuple(tmp_path / f"{number}.png" for number in range(40)), None, ((1280, 720),) * 40)
    tried = []

    def reconstruct(images, out, database, options, record, match):
        database.touch()
        tried.append(options.sift)
        record = record.add(first_octave=0)
        if len(tried) == 1:
            raise record.fail("19 of 40 images registered", kind=TooFewRegistered)
        return record

    monkeypatch.setattr(colmap, "match_and_reconstruct", reconstruct)
    record = colmap.register(image_set, tmp_path, colmap.ColmapOptions())
    assert [(sift.first_octave, sift.max_features, sift.max_side_px) for sift in tried] == [(0, 3000, 1280), (-1, 4000, 1600)]
    assert record["tried"]["colmap"]["reason"] == "19 of 40 images registered"


def test_where_the_features_are_the_finest_nothing_is_said_to_be_tried(tmp_path, monkeypatch, capsys):
    image_set = ImageSet(tuple(tmp_path / f"{number}.png" for number in range(20)), None, ((1280, 720),) * 20)

    def refuse(images, out, database, options, record, match):
        raise record.add(first_octave=-1).fail("9 of 20 images registered", kind=TooFewRegistered)

    monkeypatch.setattr(colmap, "match_and_reconstruct", refuse)
    with pytest.raises(TooFewRegistered, match="^9 of 20 images registered$") as error:
        colmap.register(image_set, tmp_path, colmap.ColmapOptions())
    assert list(error.value.figures["tried"]) == ["colmap"] and "finer" not in capsys.readouterr().err


@pytest.mark.parametrize(("octave", "finer"), [(0, -1), (-1, None)])
def test_few_images_have_finer_features_only_where_coarse_ones_were_used(octave, finer):
    found = refine(SiftOptions(), octave, 20)
    assert (found and found.first_octave) == finer
