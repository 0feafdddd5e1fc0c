"""Photos of several sizes, orientations and lenses in one capture."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image

from zeroshop_steps.geometry.cameras.pinhole import align_to_truth, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask, write_image
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.lenses import group_by_lens, import_images, read_cropped_focal_px
from zeroshop_steps.register.scene.record import find_missing
from zeroshop_steps.register.verification.consistency import ConsistencyLimits, find_contradictions
from zeroshop_steps.register.verification.epipolar_support import EpipolarSupport
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY, judge
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

SIZES = ((640, 480), (480, 640), (640, 480), (320, 240))


def write_photo(path, size, focal_35mm=None, model=None) -> None:
    pixels = np.random.default_rng(int(path.stem)).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    photo = Image.fromarray(pixels).resize(size, Image.Resampling.NEAREST)
    exif = photo.getexif()
    if focal_35mm:
        exif.get_ifd(0x8769)[0xA405] = focal_35mm
    if model:
        exif[0x0110] = model
    photo.save(path, exif=exif)


@pytest.fixture
def sizes_capture(tmp_path):
    (tmp_path / "images").mkdir()
    for number, size in enumerate(SIZES):
        write_photo(tmp_path / f"images/{number:06d}.jpg", size)
    return tmp_path


def test_each_size_has_a_lens(sizes_capture):
    image_set = read_image_set(sizes_capture)
    assert image_set.sizes_px == SIZES and image_set.scales["000003.jpg"] == 0.32
    assert group_by_lens(image_set) == [["000000.jpg", "000002.jpg"], ["000001.jpg"], ["000003.jpg"]]
    import_images(sizes_capture / "database.db", image_set)
    with pycolmap.Database.open(sizes_capture / "database.db") as opened:
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        of_image = {image.name: cameras[image.camera_id] for image in opened.read_all_images()}
    assert len(cameras) == 3
    # One field of view is assumed for all lenses whose focal length nothing tells.
    assert of_image["000001.jpg"].mean_focal_length() == of_image["000000.jpg"].mean_focal_length()
    assert of_image["000003.jpg"].mean_focal_length() == pytest.approx(of_image["000000.jpg"].mean_focal_length() / 2)


def test_each_camera_and_zoom_has_a_lens(tmp_path):
    (tmp_path / "images").mkdir()
    for number, (focal, model) in enumerate(((26, "A"), (26, "A"), (52, "A"), (26, "B"))):
        write_photo(tmp_path / f"images/{number:06d}.jpg", (640, 480), focal, model)
    assert group_by_lens(read_image_set(tmp_path)) == [["000000.jpg", "000001.jpg"], ["000002.jpg"], ["000003.jpg"]]


@pytest.mark.parametrize(
    ("size", "whole", "focal_px"),
    [
        ((600, 400), (600, 400), None),  # whole
        ((400, 600), (6000, 4000), None),  # whole, held upright and reduced
        ((400, 400), (600, 400), 1000.0),  # cropped: 60 mm on film of 36 x 24 mm, of which it has 24 x 24
        ((200, 200), (600, 400), 500.0),  # cropped and reduced
        ((400, 400), (400, 400), 1000.0),  # cropped by a program that changed the size in EXIF
        ((400, 400), None, 1000.0),
        ((600, 300), (600, 400), 1000.0),
    ],
)
def test_cropped_photos_have_the_focal_length_of_the_whole_ones(tmp_path, size, whole, focal_px):
    path = tmp_path / "images/000000.jpg"
    path.parent.mkdir()
    write_photo(path, size, 60)
    with Image.open(path) as photo:
        exif = photo.getexif()
        if whole:
            exif.get_ifd(0x8769).update(dict(zip((0xA002, 0xA003), whole, strict=True)))
        photo.save(path, exif=exif)
    assert read_cropped_focal_px(path, size) == (None if focal_px is None else pytest.approx(focal_px))
    import_images(tmp_path / "database.db", ImageSet((path,), None, (size,)))
    with pycolmap.Database.open(tmp_path / "database.db") as opened:
        (camera,) = opened.read_all_cameras()
    expected_px = focal_px or 60 * np.hypot(*size) / np.hypot(36, 24)
    assert camera.has_prior_focal_length and camera.mean_focal_length() == pytest.approx(expected_px, rel=1e-3)


def test_a_network_that_takes_one_size_says_so(sizes_capture):
    with pytest.raises(StepError, match=r"several sizes \(320 x 240, 480 x 640, 640 x 480 px\).*colmap or mast3r"):
        _ = read_image_set(sizes_capture).size_px


def test_errors_are_judged_by_the_size_of_the_image():
    names, full = ("large", "other", "small"), np.full((3, 3), 100)
    evidence = EpipolarSupport(names, full, np.zeros((3, 3), int))
    errors_px = {"large": 0.4, "other": 0.4, "small": 0.3}
    scales = {"large": 1.0, "other": 1.0, "small": 0.2}
    assert (
        judge(find_contradictions(None, evidence, errors_px, ConsistencyLimits(), dict.fromkeys(names, 1.0), {})).wrong
        < MAX_WRONG_PROBABILITY
    )
    verdict = judge(find_contradictions(None, evidence, errors_px, ConsistencyLimits(), scales, {}))
    assert (
        verdict.wrong > MAX_WRONG_PROBABILITY and verdict.findings[0].images == ("small",) and "small fits with 0.30 px" in verdict.reason
    )


@pytest.mark.slow
def test_turned_and_reduced_photos_are_registered_as_well(carton_capture, tmp_path):
    mixed, out = tmp_path / "mixed", tmp_path / "cameras"
    for number, path in enumerate(list_images(carton_capture / "images")):
        for part in ("images", "masks"):
            picture = cv2.imread(str(carton_capture / part / path.name))
            if number % 3 == 0:
                picture = cv2.rotate(picture, cv2.ROTATE_90_CLOCKWISE)
            if number % 3 == 1:
                picture = cv2.resize(picture, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
            write_image(mixed / part / path.name, np.ascontiguousarray(picture[..., ::-1]))
    shutil.copytree(carton_capture / "truth", mixed / "truth")
    words = ("--method", "colmap", "--capture", mixed, "--scene", "su_h", "--out", out, "--max-features", 1000)
    assert stage_main("zeroshop_steps.register", [str(word) for word in words]) == 0
    cameras = read_sparse_model(out / "sparse").cameras
    assert {(camera.width_px, camera.height_px) for camera in cameras} == {(360, 480), (360, 270), (480, 360)}
    for camera in cameras:
        assert read_image(out / "images" / camera.name).shape == (camera.height_px, camera.width_px, 3)
        assert read_mask(out / "masks" / camera.name).shape == (camera.height_px, camera.width_px)
    pairs = pair_with_truth(cameras, read_sparse_model(carton_capture / "truth").cameras)
    found, true = (np.array([camera.centre_in_world for camera in side]) for side in zip(*pairs, strict=True))
    error_mm = np.linalg.norm(transform_points(found, align_to_truth(pairs)) - true, axis=1)
    assert len(pairs) == 10 and error_mm.mean() < 1.0
    record = read_json(out / "registration.json")
    assert record["lens"] is None and record["lenses"]["000000"]["width_px"] == 360


@pytest.mark.parametrize(("missing", "hinted"), [(range(8), True), (range(12, 20), True), (range(6, 14), False), (range(7), False)])
def test_photos_of_another_position_are_taken_as_a_second_pass(missing, hinted):
    paths = tuple(Path(f"{index:06d}.jpg") for index in range(20))
    image_set = ImageSet(paths, None, ((640, 480),) * 20, tuple(f"IMG_{index}.JPG" for index in range(20)))
    found = find_missing(image_set, {path.name for index, path in enumerate(paths) if index not in missing})
    [warning] = found.warnings
    assert f"left out, {len(missing)} of 20 photos" in warning and f"IMG_{missing[0]}.JPG" in warning
    assert ("zeroshop FIRST SECOND" in warning) == hinted
