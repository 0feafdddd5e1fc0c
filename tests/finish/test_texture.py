from dataclasses import replace

import numpy as np
import pytest
import trimesh

from helpers.carton_scene import camera_at
from helpers.solids import as_trimesh
from zeroshop_steps.finish.texture import bake_texture, read_colored
from zeroshop_steps.finish.texturing.atlas import rasterize_atlas
from zeroshop_steps.finish.texturing.unwrap import measure_atlas_use, unwrap_mesh
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer, sample_texture
from zeroshop_steps.runtime.errors import StepError


@pytest.fixture(scope="module")
def unwrapped() -> Mesh:
    ball = trimesh.creation.icosphere(4, 20.0)
    return unwrap_mesh(Mesh(np.array(ball.vertices), np.array(ball.faces, np.int64)), 256)[0]


@pytest.fixture(scope="module")
def baked(carton):
    views, _ = read_views(carton.cameras)
    texture, figures = bake_texture(Mesh(carton.mesh.vertices, carton.mesh.faces, carton.mesh.normals, carton.mesh.uv), views, 512)
    return texture, figures


def psnr_db(a: np.ndarray, b: np.ndarray) -> float:
    return 10 * np.log10(255.0**2 / np.mean((a.astype(float) - b) ** 2))


def test_the_atlas_lies_in_the_unit_square_and_keeps_the_surface(unwrapped):
    assert unwrapped.uv.min() >= 0.0 and unwrapped.uv.max() <= 1.0
    assert len(unwrapped.faces) == 20 * 4**4
    assert as_trimesh(unwrapped).area == pytest.approx(4 * np.pi * 20.0**2, rel=0.01)
    assert np.allclose(np.linalg.norm(unwrapped.normals, axis=1), 1.0)


def test_charts_do_not_overlap(unwrapped):
    size = 512
    texels = rasterize_atlas(unwrapped, size)
    # texels covered once, counted by texel, equal the triangles' summed area
    assert len(texels.face) / size**2 == pytest.approx(measure_atlas_use(unwrapped), rel=0.02)
    assert measure_atlas_use(unwrapped) > 0.3


def test_texels_lie_at_their_uv(unwrapped):
    size = 256
    texels = rasterize_atlas(unwrapped, size)
    uv = (unwrapped.uv[unwrapped.faces[texels.face]] * texels.barycentric[:, :, None]).sum(1)
    assert np.abs(uv[:, 0] * size - (texels.column + 0.5)).max() < 1e-2
    assert np.abs((1 - uv[:, 1]) * size - (texels.row + 0.5)).max() < 1e-2


def test_texture_look_up_has_its_origin_at_the_lower_left():
    texture = np.zeros((4, 8, 3), np.uint8)
    texture[3, 0], texture[0, 7] = (255, 0, 0), (0, 0, 255)
    found = sample_texture(texture, np.array([[0.5 / 8, 0.5 / 4], [7.5 / 8, 3.5 / 4]]))
    assert np.array_equal(found, [[255, 0, 0], [0, 0, 255]])


def test_a_baked_print_renders_as_it_was(carton, baked):
    texture, figures = baked
    product = MeshRenderer(Mesh(carton.mesh.vertices, carton.mesh.faces, None, carton.mesh.uv, texture))
    truth = MeshRenderer(carton.mesh)
    for azimuth_deg in (15.0, 130.0, 250.0):
        camera = camera_at("new.png", azimuth_deg, 22.0)
        expected, mask = truth.render_masked_color(camera, 3)
        assert psnr_db(product.render_masked_color(camera, 3)[0][mask], expected[mask]) > 32.0
    assert 0.75 < figures["seen_share"] <= 1.0


def test_the_side_that_no_photo_sees_is_filled_from_its_surroundings(carton, baked):
    texture, _ = baked
    texels = rasterize_atlas(carton.mesh, 512)
    under = (carton.mesh.vertices[carton.mesh.faces[texels.face]][:, :, 2] < carton.mesh.vertices[:, 2].min() + 0.1).all(1)
    colors = texture[texels.row[under], texels.column[under]].astype(float)
    assert colors.std(0).max() < 60.0
    assert not (np.abs(colors - (90, 160, 90)).max(1) < 20).all(), "the table's colour must not come onto the object"
    assert (colors.max(1) > 20).all(), "nothing is left black"


def test_exposure_differences_leave_no_seams(carton, baked, tmp_path):
    views, _ = read_views(carton.cameras)
    changed = []
    for k, view in enumerate(views):
        path = tmp_path / view.image_path.name
        write_image(path, np.clip(read_image(view.image_path) * (0.8 if k % 2 else 1.1), 0, 255).astype(np.uint8))
        changed.append(replace(view, image_path=path))
    texture, figures = bake_texture(Mesh(carton.mesh.vertices, carton.mesh.faces, carton.mesh.normals, carton.mesh.uv), changed, 512)
    texels = rasterize_atlas(carton.mesh, 512)
    ratio = texture[texels.row, texels.column].astype(float).mean(1) / baked[0][texels.row, texels.column].astype(float).mean(1)
    assert np.std(ratio) < 0.03
    assert figures["gains"][1] / figures["gains"][0] == pytest.approx(1.1 / 0.8, rel=0.03)


def test_a_highlight_in_one_photo_leaves_no_ghost(carton, baked, tmp_path):
    views, _ = read_views(carton.cameras)
    best = max(views, key=lambda view: view.mask().sum())
    rows, columns = np.nonzero(best.mask())
    y, x = np.mgrid[: best.camera.height_px, : best.camera.width_px]
    path = tmp_path / best.image_path.name
    glare = 60.0 * np.exp(-((x - columns.mean()) ** 2 + (y - rows.mean()) ** 2) / (2 * 12.0**2))
    write_image(path, np.clip(best.image() + glare[..., None], 0, 255).astype(np.uint8))
    shiny = [replace(view, image_path=path) if view is best else view for view in views]
    texture, _ = bake_texture(Mesh(carton.mesh.vertices, carton.mesh.faces, carton.mesh.normals, carton.mesh.uv), shiny, 512)
    ghost = np.abs(texture.astype(float) - baked[0]).max(2)
    assert ghost.max() < 35 and (ghost > 10).mean() < 0.004


def test_gutters_continue_the_nearest_chart(baked):
    texture, _ = baked
    assert (texture.max(2) > 0).all()


def test_the_same_photos_give_the_same_texture(carton, baked):
    views, _ = read_views(carton.cameras)
    again, _ = bake_texture(Mesh(carton.mesh.vertices, carton.mesh.faces, carton.mesh.normals, carton.mesh.uv), views, 512)
    assert np.array_equal(again, baked[0])


def test_charts_are_never_mirrored(unwrapped):
    a, b, c = (unwrapped.uv[unwrapped.faces[:, corner]] for corner in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (area > 0).all()


def test_a_rough_surface_still_gives_few_charts():
    ball = trimesh.creation.icosphere(5, 20.0)
    rough = np.array(ball.vertices) + np.random.default_rng(0).normal(0.0, 0.15, ball.vertices.shape)
    mesh, charts = unwrap_mesh(Mesh(rough, np.array(ball.faces, np.int64)), 512)
    assert charts < 60
    assert len(rasterize_atlas(mesh, 1024).face) / 1024**2 == pytest.approx(measure_atlas_use(mesh), rel=0.05)


def test_no_face_runs_across_the_atlas(unwrapped):
    in_atlas, on_surface = (
        np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        for corners in (unwrapped.uv[unwrapped.faces], unwrapped.vertices[unwrapped.faces])
    )
    ratio = in_atlas / on_surface
    assert ratio.max() < 1.5 * np.median(ratio)


def test_faces_without_area_do_not_run_across_the_atlas():
    ball = trimesh.creation.icosphere(3, 20.0)
    faces = np.concatenate([np.array(ball.faces, np.int64), [[0, 1, len(ball.vertices)]]])
    vertices = np.concatenate([ball.vertices, [ball.vertices[[0, 1]].mean(0)]])
    mesh, _ = unwrap_mesh(Mesh(vertices, faces), 256)
    assert len(mesh.faces) == len(faces)
    corners = mesh.uv[mesh.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() < 0.2


def test_what_no_photo_sees_takes_the_generated_colour(carton, baked):
    """The generated mesh is darker than the photos; its print below the carton comes out as bright as these."""
    truth = carton.mesh
    colors = np.clip(0.8 * sample_texture(truth.texture, truth.uv), 0, 255).astype(np.uint8)
    generated = Mesh(truth.vertices + 0.3, truth.faces, colors=colors)
    views, _ = read_views(carton.cameras)
    texture, figures = bake_texture(Mesh(truth.vertices, truth.faces, truth.normals, truth.uv), views, 512, generated)
    below = np.flatnonzero(truth.face_normals()[:, 2] < -0.9)
    uv = truth.uv[truth.faces[below]].mean(1)
    true = sample_texture(truth.texture, uv)
    error, blind = (np.abs(sample_texture(found, uv) - true).mean() for found in (texture, baked[0]))
    assert error < 15 < 0.5 * blind
    assert figures["generated_share"] == pytest.approx(1 - figures["seen_share"], abs=1e-5)
    seen = sample_texture(baked[0], truth.uv[truth.faces].mean(1)) - sample_texture(texture, truth.uv[truth.faces].mean(1))
    assert np.abs(np.delete(seen, below, axis=0)).mean() < 1.0, "photos decide where they look"


def test_a_generated_mesh_without_colours_is_refused(carton):
    with pytest.raises(StepError, match="has no colours"):
        read_colored(carton.model)
