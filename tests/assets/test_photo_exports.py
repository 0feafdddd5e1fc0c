"""Photos and cameras for other tools: what they reproject is what the photos show."""

import json

import numpy as np
import pycolmap
import pytest

from helpers.faults import step
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.files import write_json

OBJECT_FROM_REGISTRATION = np.array([[0.0, -2, 0, 10], [2, 0, 0, -20], [0, 0, 2, 5], [0, 0, 0, 1]])
"""To millimetres: turned by 90 degrees about z, twice as large, and moved."""


@pytest.fixture(scope="module")
def product(carton, tmp_path_factory):
    """The carton's mesh in an object frame of its own."""
    folder = tmp_path_factory.mktemp("product")
    moved = transform_points(carton.mesh.vertices, OBJECT_FROM_REGISTRATION)
    write_ply(folder / "2dgs.ply", Mesh(moved, carton.mesh.faces))
    facts = {"scale": "known", "scale_source": "known_height", "height_m": 0.1, "height_deviation_m": 0.001}
    write_json(folder / "2dgs.json", facts | {"frame_facts": {"object_from_registration": OBJECT_FROM_REGISTRATION.tolist()}})
    return folder / "2dgs.ply", moved / 1000, carton.cameras


def test_nerfstudio_cameras_see_the_mesh_where_the_photos_show_it(product, tmp_path):
    mesh, vertices_m, cameras = product
    assert step("assets", "nerfstudio", mesh=mesh, cameras=cameras, out=tmp_path / "ns") == 0
    content = json.loads((tmp_path / "ns/transforms.json").read_text())
    views, _ = read_views(cameras)
    assert len(content["frames"]) == len(views) and (tmp_path / "ns" / content["ply_file_path"]).is_file()
    for frame, view in zip(content["frames"], views, strict=True):
        assert (tmp_path / "ns" / frame["file_path"]).read_bytes() == view.image_path.read_bytes()
        pose = np.array(frame["transform_matrix"])
        assert np.isclose(np.linalg.det(pose[:3, :3]), 1)
        seen = transform_points(vertices_m, np.linalg.inv(pose))
        assert (seen[:, 2] < 0).all(), "OpenGL: in front is -z"
        pixels = seen[:, :2] / -seen[:, 2:] * (frame["fl_x"], -frame["fl_y"]) + (frame["cx"], frame["cy"])
        expected, _ = view.camera.project(transform_points(1000 * vertices_m, np.linalg.inv(OBJECT_FROM_REGISTRATION)))
        assert np.abs(pixels - expected).max() < 0.01
        if "mask_path" in frame:
            assert read_mask(tmp_path / "ns" / frame["mask_path"]).shape == (frame["h"], frame["w"])


def test_colmap_reads_its_folder_and_finds_the_same_pixels(product, tmp_path):
    mesh, vertices_m, cameras = product
    assert step("assets", "colmap", mesh=mesh, cameras=cameras, out=tmp_path / "cm") == 0
    model = pycolmap.Reconstruction(tmp_path / "cm/sparse/0")
    views, _ = read_views(cameras)
    assert model.num_reg_images() == len(views)
    by_name = {image.name: image for image in model.images.values()}
    for view in views:
        image = by_name[view.camera.name]
        assert read_image(tmp_path / "cm/images" / image.name).shape[:2] == (view.camera.height_px, view.camera.width_px)
        expected, _ = view.camera.project(transform_points(1000 * vertices_m, np.linalg.inv(OBJECT_FROM_REGISTRATION)))
        pixels = np.array([image.project_point(point) for point in vertices_m])
        assert np.abs(pixels - expected).max() < 0.01


def test_a_mesh_of_unknown_scale_gives_no_metric_cameras(product, tmp_path, capsys):
    mesh, _, cameras = product
    copy = tmp_path / "2dgs.ply"
    copy.write_bytes(mesh.read_bytes())
    write_json(tmp_path / "2dgs.json", {"scale": "unknown", "scale_source": "none", "height_m": None, "height_deviation_m": None})
    assert step("assets", "colmap", mesh=copy, cameras=cameras, out=tmp_path / "cm") == 1
    assert "is unknown" in capsys.readouterr().err and not (tmp_path / "cm").exists()
