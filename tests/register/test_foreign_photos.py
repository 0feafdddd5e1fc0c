"""Photos that fit nowhere are left out and named; photos of two scenes in equal parts are refused with the groups that they form."""

import shutil

import cv2
import numpy as np
import pycolmap
import pytest

from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import list_images, read_image, write_image
from zeroshop_steps.register.matching.view_graph import find_components
from zeroshop_steps.register.pipeline import StructureOptions, reconstruct
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import Record, RegistrationFailed
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json


def write_pairs(folder, groups) -> ImageSet:
    """A database in which all pairs of a group share matches, with 15 by chance between the groups."""
    names = [name for group in groups for name in group]
    points = np.random.default_rng(0).uniform(20, 460, (100, 2)).astype(np.float32)
    with pycolmap.Database.open(folder / "database.db") as opened:
        camera_id = opened.write_camera(pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 600.0, 640, 480))
        ids = {}
        for name in names:
            ids[name] = opened.write_image(pycolmap.Image(name=name, camera_id=camera_id))
            opened.write_keypoints(ids[name], points)
        for first in names:
            for second in names:
                if first < second:
                    together = any(first in group and second in group for group in groups)
                    geometry = pycolmap.TwoViewGeometry()
                    geometry.config = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
                    geometry.inlier_matches = np.repeat(np.arange(80 if together else 15, dtype=np.uint32)[:, None], 2, axis=1)
                    opened.write_two_view_geometry(ids[first], ids[second], geometry)
    paths = tuple(folder / "images" / name for name in names)
    return ImageSet(paths, None, ((640, 480),) * len(names), tuple(f"IMG_{name}" for name in names))


def test_groups_are_found_by_their_matches(tmp_path):
    groups = [[f"a{index}.jpg" for index in range(5)], ["b0.jpg", "b1.jpg"], ["c.jpg"]]
    write_pairs(tmp_path, groups)
    assert find_components(tmp_path / "database.db") == groups


def test_photos_of_two_scenes_are_refused_by_group(tmp_path):
    groups = [[f"a{index}.jpg" for index in range(9)], [f"b{index}.jpg" for index in range(10)]]
    image_set = write_pairs(tmp_path, groups)
    options = StructureOptions(leave_out=True, min_images=11)
    with pytest.raises(RegistrationFailed, match=r"10 photos \(IMG_b0.jpg to IMG_b9.jpg\), 9 photos \(IMG_a0.jpg to IMG_a8.jpg\)"):
        reconstruct(tmp_path / "database.db", image_set, tmp_path / "out", options, Record())


@pytest.mark.slow
def test_photos_of_another_place_are_left_out_and_named(carton_capture, tmp_path, capsys):
    capture, out = tmp_path / "capture", tmp_path / "cameras"
    shutil.copytree(carton_capture / "images", capture / "images")
    others = [f"{index:06d}.png" for index in range(10, 14)]
    for seed, name in enumerate(others):
        blocks = np.random.default_rng(seed).integers(0, 255, (36, 48, 3), dtype=np.uint8)
        write_image(capture / "images" / name, cv2.resize(blocks, (480, 360), interpolation=cv2.INTER_CUBIC))
    write_json(capture / "capture.json", {"source_names": [f"IMG_{index}.jpg" for index in range(14)]})
    words = ("--method", "colmap", "--capture", capture, "--scene", "video", "--out", out, "--max-features", 1000)
    assert stage_main("zeroshop_steps.register", [str(word) for word in words]) == 0
    record = read_json(out / "registration.json")
    assert record["registered"] == 10 and record["unregistered"] == record["foreign"] == others
    assert "left out, 4 of 14 photos have no sure place among the others: IMG_10.jpg, IMG_11.jpg" in capsys.readouterr().err


@pytest.mark.slow
def test_a_hand_in_some_photos_does_not_move_the_cameras(carton_capture, tmp_path):
    """In four of ten photos, something with a texture of its own reaches in, each time at another place."""
    capture, out = tmp_path / "capture", tmp_path / "cameras"
    hand = cv2.resize(np.random.default_rng(3).integers(60, 220, (24, 18, 3), dtype=np.uint8), (140, 190), interpolation=cv2.INTER_CUBIC)
    for number, path in enumerate(list_images(carton_capture / "images")):
        image = read_image(path)
        if number % 3 == 0:
            left = 25 * number
            image[-190:, left : left + 140] = hand
        write_image(capture / "images" / path.name, image)
    words = ("--method", "colmap", "--capture", capture, "--scene", "video", "--out", out, "--max-features", 1000)
    assert stage_main("zeroshop_steps.register", [str(word) for word in words]) == 0
    error = compare_cameras(read_sparse_model(out / "sparse").cameras, read_sparse_model(carton_capture / "truth").cameras)
    assert len(error.names) == 10 and error.centre_mm.mean() < 1.0
