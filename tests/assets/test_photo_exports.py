"""Photos and cameras for other tools: what they reproject is what the photos show."""

import json
import shutil

import numpy as np
import pycolmap
import pytest

from helpers.faults import step
from zeroshop_steps.app.importing import import_capture
from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.capture.adapters.form import ImportOptions
from zeroshop_steps.capture.cameras_json import read_given_cameras
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.imaging.images import compute_overlap, read_image, read_mask, write_mask
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


def test_a_bop_sequence_comes_back_by_our_adapter(product, tmp_path):
    """Poses, lenses, masks and pictures are those of the cameras, and the JSON says what the masks and the mesh show."""
    mesh, vertices_m, cameras = product
    assert step("assets", "bop", mesh=mesh, cameras=cameras, out=tmp_path / "2dgs.bop") == 0
    sequence = tmp_path / "2dgs.bop/obj_000001_up"
    import_capture(sequence, tmp_path / "back", ImportOptions())
    given, (views, _) = read_given_cameras(tmp_path / "back/cameras.json"), read_views(cameras)
    views = [view for view in views if view.mask_path is not None]
    assert given.metric and len(given.images) == len(views) > 5
    info = json.loads((sequence / "scene_gt_info.json").read_text())
    for number, view in enumerate(views):
        name = f"{number:06d}{view.image_path.suffix}"
        one, k = given.images[name], view.camera.intrinsics
        assert np.allclose(one.lens.params, (k[0, 0], k[1, 1], k[0, 2], k[1, 2]))
        seen = transform_points(vertices_m, one.camera_from_world)
        expected, _ = view.camera.project(transform_points(1000 * vertices_m, np.linalg.inv(OBJECT_FROM_REGISTRATION)))
        assert np.abs((seen @ k.T)[:, :2] / seen[:, 2:] - expected).max() < 0.01
        assert (tmp_path / "back/images" / name).read_bytes() == view.image_path.read_bytes()
        mask = read_mask(tmp_path / f"back/masks/{number:06d}.png")
        assert (mask == view.mask()).all() and compute_overlap(read_mask(sequence / f"mask/{number:06d}_000000.png"), mask) > 0.9
        assert info[str(number)][0]["px_count_visib"] == mask.sum() and 0.8 < info[str(number)][0]["visib_fract"] <= 1


def test_a_bop_scene_of_several_objects_has_masks_of_each(product, tmp_path):
    """Two in the same photos, of which one does not show the second: numbers and masks are those of the object that is asked for."""
    mesh, _, cameras = product
    second = shutil.copytree(cameras, tmp_path / "second")
    views = read_views(second)[0][1:]
    write_cameras(second / "sparse", [view.camera for view in views])
    for view in views:
        write_mask(view.mask_path, np.roll(view.mask(), 5, 1))
    assert step("assets", "bop", "--mesh", mesh, mesh, "--cameras", cameras, second, out=tmp_path / "2dgs.bop") == 0
    frames = read_scene(tmp_path / "2dgs.bop/000001")
    assert [[one.object_id for one in frame.instances] for frame in frames.values()] == [[1]] + [[1, 2]] * (len(frames) - 1)
    import_capture(tmp_path / "2dgs.bop/000001", tmp_path / "back", ImportOptions(object_id=2))
    back = sorted((tmp_path / "back/masks").iterdir())
    assert all((read_mask(one) == view.mask()).all() for one, view in zip(back, views, strict=True))


def test_meshes_and_cameras_for_bop_go_in_pairs(product, tmp_path, capsys):
    mesh, _, cameras = product
    assert step("assets", "bop", "--mesh", mesh, mesh, cameras=cameras, out=tmp_path / "2dgs.bop") == 1
    assert "name one for each mesh" in capsys.readouterr().err
