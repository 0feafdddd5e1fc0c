"""Training from nothing but the masks and the registration's sparse points."""

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from zeroshop_steps.geometry.cameras.object_crops import fit_object_sphere
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface import svraster, twodgs
from zeroshop_steps.surface.rendering.training_views import make_seed_views, read_camera_set
from zeroshop_steps.surface.training.training_run import make_sparse_seeds

SEEING = 4
"""Images that see each point."""


@pytest.fixture(scope="module")
def registered(carton, tmp_path_factory) -> Path:
    """The carton's cameras with 60 points on its sides, each seen by the images nearest to it, and one on the table."""
    folder = tmp_path_factory.mktemp("registered") / "cameras"
    shutil.copytree(carton.cameras, folder)
    model = pycolmap.Reconstruction(str(folder / "sparse"))
    faces = carton.mesh.vertices[carton.mesh.faces].mean(1)
    points = np.random.default_rng(0).permutation(faces[faces[:, 2] > -30.0])[:60]
    images = list(model.images.values())
    tracks: dict[int, list[np.ndarray]] = {image.image_id: [] for image in images}
    elements = []
    for point in [*points, np.array([80.0, 0.0, -45.0])]:
        nearest = sorted(images, key=lambda image: -float(image.projection_center() @ point))[:SEEING]
        elements.append([(image.image_id, len(tracks[image.image_id])) for image in nearest])
        for image in nearest:
            tracks[image.image_id].append(point)
    for image in images:
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array([1.0, 1.0])) for _ in tracks[image.image_id]])
    for point, seen in zip([*points, np.array([80.0, 0.0, -45.0])], elements, strict=True):
        model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(*element) for element in seen]), np.full(3, 128, np.uint8))
    model.write_binary(str(folder / "sparse"))
    return folder


def test_the_depths_of_sparse_points_are_known_where_their_images_see_them_in_the_mask(carton, registered):
    cameras = read_camera_set(registered)
    sphere = fit_object_sphere(cameras.model.cameras, cameras.masks)
    seeds = make_sparse_seeds(registered, sphere, make_seed_views(cameras, sphere))
    assert len(seeds.positions) == 0 and seeds.carved_hull.occupied.any()
    count = sum(int((depth > 0).sum()) for depth in seeds.depth_maps.values())
    assert 0.5 * 60 * SEEING < count <= 60 * SEEING, "those of the table are left out; a few points share a pixel"
    for camera in cameras.model.cameras:
        depth = seeds.depth_maps[camera.name]
        expected = camera.project(carton.mesh.vertices)[1] / sphere.radius
        known = depth[depth > 0]
        assert len(known) == 0 or (known.min() > expected.min() - 1e-3 and known.max() < expected.max() + 1e-3)


@pytest.mark.parametrize("module", [twodgs, svraster])
def test_training_starts_without_stereo(module, registered, tmp_path):
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    words = ["--cameras", str(registered), "--out", str(tmp_path), "--iterations", "20", "--image-width-px", "160", "--threads", "1"]
    with pytest.raises(StepError, match="--initialization sparse"):
        module.run(parser.parse_args(words))
    module.run(parser.parse_args([*words, "--initialization", "sparse", "--lambda-depth", "0.25", "--count-max", "9000"]))
    record = json.loads((tmp_path / "training.json").read_text())
    assert record["settings"]["initialization"] == "sparse" and record["settings"]["count_max"] == 9000
    if module is twodgs:
        assert 40 < record["disks"] <= 60, "a surfel at each point of the object, less those that fade"
