import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from zeroshop_steps.finish import export
from zeroshop_steps.finish.frame import compute_object_frame
from zeroshop_steps.finish.preview import draw_preview
from zeroshop_steps.finish.publish import publish_product
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.support_classes import ASSUMED, MEASURED
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer, sample_texture
from zeroshop_steps.height.object_pose import measure_above_plane
from zeroshop_steps.height.record import Scale, describe_height
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.runtime.open3d_loader import o3d


@pytest.fixture(scope="module")
def product(carton, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cell")
    views, _ = read_views(carton.cameras)
    object_pose = measure_above_plane(carton.mesh, views, None)
    scale = Scale("known_height", 0.18 / object_pose.extent, 0.001, {})  # twice its size
    write_json(folder / "frame.json", compute_object_frame(carton.mesh, views, describe_height(object_pose, scale)) | {"seconds": 1.5})
    write_json(folder / "clean.json", {"seconds": 2.0, "parameters": {"smooth": 5}})
    write_json(folder / "registration.json", {"seconds": {"total": 30.25}})
    write_json(folder / "stereo.json", {"seconds": 3.0, "given_depth": {"camera": "tof", "added_pixels": 7}})
    stages = export.read_stages(folder / f"{name}.json" for name in ("clean", "registration", "frame", "stereo"))
    mesh = export.move_to_object_frame(carton.mesh, np.array(stages["frame"]["object_from_registration"]), carton.mesh.texture)
    export.write_product(folder / "mesh.ply", mesh, export.make_metadata(mesh, stages["frame"], stages))
    return folder / "mesh.ply"


def test_the_ply_reads_back_in_millimetres_with_normals_and_texture(carton, product):
    mesh = read_ply(product)
    assert np.allclose(np.ptp(mesh.vertices, axis=0), 2 * np.ptp(carton.mesh.vertices, axis=0), rtol=1e-4)
    assert np.allclose(mesh.vertices.max(0), -mesh.vertices.min(0), atol=1e-3)
    assert np.array_equal(mesh.faces, carton.mesh.faces)
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    assert np.array_equal(mesh.texture, carton.mesh.texture)
    assert b"comment TextureFile mesh.png" in product.read_bytes()[:300]
    other = trimesh.load(product)
    assert np.allclose(other.vertices, mesh.vertices)


def test_the_glb_is_in_metres_with_y_up_and_the_print_is_not_mirrored(carton, product):
    ply = read_ply(product)
    loaded = trimesh.load(product.with_suffix(".glb"), force="mesh")
    assert np.allclose(np.ptp(loaded.vertices, axis=0), np.ptp(ply.vertices, axis=0)[[0, 2, 1]] / 1000, rtol=1e-4)
    assert loaded.volume > 0
    # the same place carries the same colour: (x, y, z) in mm is (x, z, -y) in m
    points, index = trimesh.sample.sample_surface(loaded, 300, seed=0)
    weights = trimesh.triangles.points_to_barycentric(loaded.triangles[index], points)
    uv = (loaded.visual.uv[loaded.faces[index]] * weights[:, :, None]).sum(1)
    in_glb = sample_texture(np.array(loaded.visual.material.baseColorTexture.convert("RGB")), uv)
    places = np.c_[points[:, 0], -points[:, 2], points[:, 1]] * 1000
    face, second, third = nearest(ply, places)
    corners = ply.uv[ply.faces[face]]
    uv = corners[:, 0] * (1 - second - third) + corners[:, 1] * second + corners[:, 2] * third
    assert np.median(np.abs(in_glb - sample_texture(ply.texture, uv))) < 1.0


def nearest(mesh: Mesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face and barycentric position of the nearest surface point."""
    answer = MeshRenderer(mesh).scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
    weights = answer["primitive_uvs"].numpy()
    return answer["primitive_ids"].numpy().astype(int), weights[:, :1], weights[:, 1:]


def test_gltf_texture_coordinates_start_at_the_upper_left(product):
    data = product.with_suffix(".glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    header, body = json.loads(data[20 : 20 + length]), data[28 + length :]
    accessor = header["accessors"][header["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]]
    view = header["bufferViews"][accessor["bufferView"]]
    stored = np.frombuffer(body, "<f4", 2 * accessor["count"], view.get("byteOffset", 0) + accessor.get("byteOffset", 0)).reshape(-1, 2)
    uv = read_ply(product).uv
    assert np.allclose(stored, np.c_[uv[:, 0], 1.0 - uv[:, 1]], atol=1e-5)


def test_the_json_says_units_scale_versions_and_seconds(product):
    notes = read_json(product.with_suffix(".json"))
    assert (notes["ply_unit"], notes["glb_unit"], notes["scale"]) == ("millimetre", "metre", "known")
    assert notes["seconds"] == {"clean": 2.0, "register": 30.25, "frame": 1.5, "stereo": 3.0, "total": 36.75}
    assert notes["given_depth"] == {"camera": "tof", "added_pixels": 7}
    assert notes["parameters"]["clean"] == {"smooth": 5}
    assert notes["versions"]["open3d"]


def test_publishing_renames_the_texture_and_adds_quality(product, tmp_path):
    write_json(tmp_path / "quality.json", {"accuracy_mm": 0.5})
    write_image(tmp_path / "mesh_preview.png", np.zeros((4, 4, 3), np.uint8))
    publish_product(product, tmp_path / "out" / "2dgs.ply", tmp_path / "mesh_preview.png", tmp_path / "quality.json")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "2dgs.glb",
        "2dgs.json",
        "2dgs.ply",
        "2dgs.png",
        "2dgs.preview.png",
    ]
    published, cell = read_ply(tmp_path / "out" / "2dgs.ply"), read_ply(product)
    assert np.array_equal(published.vertices, cell.vertices) and np.array_equal(published.texture, cell.texture)
    assert read_json(tmp_path / "out" / "2dgs.json")["quality"] == {"accuracy_mm": 0.5}


def test_a_published_mesh_tells_what_was_measured(product, tmp_path):
    cell = read_ply(product)
    evidence = np.where(cell.vertices[:, 2] > 0, MEASURED, ASSUMED).astype(np.uint8)
    np.savez(tmp_path / "evidence.npz", evidence=evidence)
    publish_product(product, tmp_path / "out" / "2dgs.ply", evidence=tmp_path / "evidence.npz")
    published = read_ply(tmp_path / "out" / "2dgs.ply")
    np.testing.assert_array_equal(published.quality, evidence / MEASURED)
    shares = read_json(tmp_path / "out" / "2dgs.json")["area_shares"]
    assert shares["unseen"] == 0 < shares["assumed"] < 1 and sum(shares.values()) == pytest.approx(1.0, abs=1e-4)
    np.savez(tmp_path / "evidence.npz", evidence=evidence[:-1])
    with pytest.raises(StepError, match="its mesh has"):
        publish_product(product, tmp_path / "other.ply", evidence=tmp_path / "evidence.npz")
    assert not (tmp_path / "other.ply").exists()


def test_publishing_an_unfinished_cell_is_refused(product, tmp_path):
    (tmp_path / "mesh.ply").write_bytes(product.read_bytes())
    with pytest.raises(StepError, match="mesh.png"):
        publish_product(tmp_path / "mesh.ply", tmp_path / "2dgs.ply")
    assert not (tmp_path / "2dgs.ply").exists()


def test_the_preview_shows_the_mesh_where_the_photo_shows_the_object(carton, product):
    views, _ = read_views(carton.cameras)
    notes = read_json(product.with_suffix(".json"))
    moved = np.array(notes["frame_facts"]["object_from_registration"])
    picture = draw_preview(read_ply(product), [replace(view, camera=transform_camera(view.camera, moved)) for view in views], 3)
    photo, render, shape = picture[:320], picture[320:640], picture[640:]
    on_object = (shape < 250).any(2)
    assert np.abs(photo[on_object].astype(float) - render[on_object]).mean() < 6.0
    assert read_image(views[0].image_path).shape == (240, 320, 3)
