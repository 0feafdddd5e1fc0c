"""A whole cell from views of several sizes, some on their side: as good as the one from equal views."""

import json
import shutil

import cv2
import numpy as np
import pytest

from helpers.running import run_snakemake
from zeroshop_steps.geometry.cameras import Camera, read_sparse_model, write_cameras

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

PRODUCT = "results/demo/mustard_bottle/2dgs.ply"
CONFIG = """
chosen: {virtual: {registration: truth}}
capture: {image_width_px: 320, image_height_px: 240}
nvs:
  2dgs: {train: {iterations: 60, image_width_px: 160, sh_degree: 0}, fuse: {voxels: 64, image_width_px: 160}}
finish: {texture_size_px: 256, clean: {max_faces: 3000}}
"""
QUARTER = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # x right and y down of a picture turned clockwise


def mix_views(capture) -> None:
    """Turn every third view clockwise, reduce every third to three quarters, and the true cameras alike."""
    cameras = []
    for number, camera in enumerate(read_sparse_model(capture / "truth").cameras):
        for part, interpolation in (("images", cv2.INTER_AREA), ("masks", cv2.INTER_NEAREST)):
            path = str(capture / part / camera.name)
            picture = cv2.imread(path, cv2.IMREAD_UNCHANGED)
            if number % 3 == 0:
                picture = cv2.rotate(picture, cv2.ROTATE_90_CLOCKWISE)
            elif number % 3 == 1:
                picture = cv2.resize(picture, None, fx=0.75, fy=0.75, interpolation=interpolation)
            cv2.imwrite(path, picture)
        fx, fy, cx, cy = camera.pinhole_params
        if number % 3 == 0:
            intrinsics = np.array([[fy, 0, camera.height_px - cy], [0, fx, cx], [0, 0, 1]])
            camera = Camera(camera.name, camera.height_px, camera.width_px, intrinsics, QUARTER @ camera.camera_from_world)
        elif number % 3 == 1:
            camera = camera.resized(round(0.75 * camera.width_px), round(0.75 * camera.height_px))
        cameras.append(camera)
    shutil.rmtree(capture / "truth")
    write_cameras(capture / "truth", cameras)


def test_mixed_views_make_as_good_a_mesh(tmp_path):
    folder = tmp_path / "mixed"
    folder.mkdir()
    (folder / "small.yaml").write_text(CONFIG)
    run = run_snakemake(folder, PRODUCT, "--configfile", "small.yaml")
    assert run.returncode == 0, run.stdout
    whole = folder / "results/demo/mustard_bottle"
    equal = json.loads((whole / "2dgs.json").read_text())["quality"]
    mix_views(whole / "su_h/capture")
    shutil.rmtree(whole / "su_h/truth")
    for path in whole.glob("2dgs.*"):
        path.unlink()
    run = run_snakemake(folder, PRODUCT, "--configfile", "small.yaml", "--rerun-triggers", "mtime")
    assert run.returncode == 0, run.stdout
    mixed = json.loads((whole / "2dgs.json").read_text())["quality"]
    assert mixed["f_score_1_percent"] > equal["f_score_1_percent"] - 0.05
    assert mixed["accuracy_mm"] < 1.25 * equal["accuracy_mm"]
    assert mixed["silhouette_iou"] > equal["silhouette_iou"] - 0.02
