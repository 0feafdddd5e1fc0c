"""An object that touches its support in the middle alone does not stand on walls below its ends."""

import numpy as np
import pytest
import trimesh

from helpers.carton_scene import camera_at
from helpers.memory_view import MemoryView
from helpers.solids import as_trimesh
from zeroshop_steps.finish.closing.close import Closing, close_mesh
from zeroshop_steps.finish.closing.overhang import lift_underside
from zeroshop_steps.finish.closing.underside import close_underside, find_open_borders
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer

UP, DOWN = np.array([0.0, 0.0, 1.0]), -0.9
BAR_MM, RISE_MM = (120.0, 30.0, 24.0), 5.0


def solid(overhangs: bool) -> trimesh.Trimesh:
    """A bar that lies on the plane z = 0, or one whose ends rise from it as a banana's do."""
    bar = trimesh.creation.box(BAR_MM).subdivide_to_size(4.0)
    bar.apply_translation([0, 0, BAR_MM[2] / 2])
    if overhangs:
        bar.vertices[:, 2] += RISE_MM * (2 * bar.vertices[:, 0] / BAR_MM[0]) ** 2
    return bar


def photographed(whole: trimesh.Trimesh) -> tuple[Mesh, list[MemoryView]]:
    """Its surface without what faces down, and views of it from all around."""
    mesh = Mesh(np.array(whole.vertices), np.array(whole.faces)).with_normals()
    renderer = MeshRenderer(mesh)
    rings = [camera_at(f"{k}_{elevation}.png", 36.0 * k, elevation, 260.0) for k in range(10) for elevation in (8.0, 45.0)]
    views = [MemoryView(camera, camera.name, None, renderer.cast_rays(camera).mask) for camera in rings]
    return Mesh(mesh.vertices, mesh.faces[whole.face_normals[:, 2] > DOWN]).without_loose_vertices().with_normals(), views


def closed_flat(mesh: Mesh, bottom: float) -> tuple[Mesh, int]:
    """The mesh closed flat, and the first face that was added."""
    whole, underside = close_underside(mesh, UP, bottom)
    assert underside.state == "closed" and underside.watertight
    return whole, underside.first_face


def test_the_space_below_the_ends_stays_open():
    mesh, views = photographed(solid(True))
    flat, first_face = closed_flat(mesh, 0.0)
    lifted = lift_underside(flat, len(mesh.vertices), first_face, UP, views)
    true = solid(True).volume
    assert abs(as_trimesh(lifted).volume / true - 1) < 0.03 < 0.06 < as_trimesh(flat).volume / true - 1
    assert as_trimesh(lifted).is_watertight and not find_open_borders(lifted.faces)
    assert np.array_equal(lifted.vertices[: len(mesh.vertices)], mesh.vertices) and np.array_equal(lifted.faces, flat.faces)
    added = lifted.vertices[len(mesh.vertices) :]
    assert added[:, 2].min() < 0.5  # it still stands on the plane
    assert (added[:, 2] <= RISE_MM * (2 * added[:, 0] / BAR_MM[0]) ** 2 + 1.5).all()  # and nothing is cut into


@pytest.mark.parametrize("bottom", [0.0, -0.5, 0.5])
def test_what_stands_on_the_plane_stays_flat(bottom):
    """The plane is known to half a millimetre or so."""
    mesh, views = photographed(solid(False))
    flat, first_face = closed_flat(mesh, bottom)
    assert lift_underside(flat, len(mesh.vertices), first_face, UP, views) is flat


def test_a_single_wrong_mask_lifts_nothing():
    mesh, views = photographed(solid(False))
    views[0] = MemoryView(views[0].camera, views[0].image_path, None, np.zeros_like(views[0].mask()))
    flat, first_face = closed_flat(mesh, 0.0)
    assert lift_underside(flat, len(mesh.vertices), first_face, UP, views) is flat


def test_closing_lifts_it():
    mesh, views = photographed(solid(True))
    height = {"up": UP.tolist(), "bottom": 0.0, "up_source": "support_plane", "up_uncertainty": {}}
    closed, facts = close_mesh(mesh, height, views, Closing(hollows="kept"))
    assert facts["closing"] == {"method": "flat", "ground_share": 0.0, "watertight": True}
    assert as_trimesh(closed).volume == pytest.approx(solid(True).volume, rel=0.03)
