"""What of a mesh was measured: outlines and confirmed print are, the lid over a plain hollow and an underside are not."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from helpers.carton_scene import camera_at
from zeroshop_steps.evaluate.finished_mesh import classify_finished_mesh
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.imaging.images import write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.support_classes import ASSUMED, MEASURED, UNSEEN, compute_area_shares, with_surface_support
from zeroshop_steps.geometry.observation.vertex_support import classify_surface_support
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.errors import StepError

RADIUS_MM, HEIGHT_MM = 40.0, 60.0


@pytest.fixture(scope="module")
def cup(tmp_path_factory):
    """A cup as its hull has it, closed above; views of it from the side, some edge-on to the lid."""
    solid = trimesh.creation.cylinder(RADIUS_MM, HEIGHT_MM, sections=96)
    for _ in range(4):
        solid = solid.subdivide()
    mesh = Mesh(np.array(solid.vertices), np.array(solid.faces)).with_normals()
    folder = tmp_path_factory.mktemp("cup")
    views = []
    for k in range(24):
        camera = camera_at(f"{k:06d}.png", 15.0 * k, (2.0, 25.0, 45.0)[k % 3])
        mask = folder / camera.name
        write_mask(mask, MeshRenderer(mesh).cast_rays(camera).mask)
        views.append(View(camera, mask, mask))
    return mesh, views


def places(mesh: Mesh) -> dict[str, np.ndarray]:
    """Vertices of the lid's middle, the wall's and the underside's."""
    radius, z = np.linalg.norm(mesh.vertices[:, :2], axis=1), mesh.vertices[:, 2]
    return {
        "lid": (radius < 0.7 * RADIUS_MM) & (z > 0.49 * HEIGHT_MM),
        "wall": (radius > 0.99 * RADIUS_MM) & (np.abs(z) < 0.4 * HEIGHT_MM),
        "underside": (radius < 0.9 * RADIUS_MM) & (z < -0.49 * HEIGHT_MM),
    }


def test_outlines_measure_a_round_wall_and_no_lid(cup):
    mesh, views = cup
    evidence = classify_surface_support(mesh, views, np.zeros((0, 3)))
    where = places(mesh)
    assert (evidence[where["wall"]] == MEASURED).mean() > 0.95
    assert (evidence[where["lid"]] == ASSUMED).mean() > 0.95, "two degrees above the lid's plane, an outline shows its rim alone"
    assert (evidence[where["underside"]] == UNSEEN).all()


@pytest.mark.slow
def test_stereo_measures_what_hangs_together_with_an_outline(cup):
    mesh, views = cup
    lid = places(mesh)["lid"]
    top = mesh.vertices[mesh.vertices[:, 2] > 0.49 * HEIGHT_MM]
    assert (classify_surface_support(mesh, views, top)[lid] == MEASURED).all()
    spot = top[np.linalg.norm(top[:, :2], axis=1) < 0.2 * RADIUS_MM]
    assert (classify_surface_support(mesh, views, spot)[lid] == ASSUMED).mean() > 0.95


def test_shares_are_of_the_area(cup):
    mesh, _ = cup
    evidence = np.where(mesh.vertices[:, 2] > 0, MEASURED, UNSEEN)
    shares = compute_area_shares(replace(mesh, quality=evidence / MEASURED))
    assert shares["measured"] == pytest.approx(0.5, abs=0.05) and sum(shares.values()) == pytest.approx(1.0, abs=1e-4)


def test_a_file_of_another_mesh_is_refused(cup, tmp_path):
    np.savez(tmp_path / "evidence.npz", evidence=np.zeros(7, np.uint8))
    with pytest.raises(StepError, match="has 7 vertices"):
        with_surface_support(cup[0], tmp_path / "evidence.npz")
    (tmp_path / "evidence.npz").write_bytes(b"PK half of it")
    with pytest.raises(StepError, match="not a complete evidence file"):
        with_surface_support(cup[0], tmp_path / "evidence.npz")


def test_a_stereo_of_other_cameras_is_refused(carton, tmp_path):
    views, _ = read_views(carton.cameras)
    metadata = {"frame_facts": {"object_from_registration": np.eye(4).tolist()}}
    with pytest.raises(StepError, match="run stereo first"):
        classify_finished_mesh(carton.mesh, metadata, views, tmp_path / "seeds.npz")
