"""Objects whose sides look alike look the same after a turn, and only then."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from helpers.benchmark_scripts import load_script
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.runtime.open3d_loader import ray_caster


@pytest.fixture(scope="module")
def objects():
    yield from load_script("alike_objects")


def take_photo(objects, kind, azimuth_deg):
    mesh, middle = objects.make_mesh(kind, 1), np.array([0, 0, kind.height_mm / 2])
    place = middle + 300 * direction_at(np.radians(azimuth_deg), 0.4)
    intrinsics = make_intrinsics(objects.FOCAL_PX, objects.WIDTH_PX, objects.HEIGHT_PX)
    camera = Camera("0.png", objects.WIDTH_PX, objects.HEIGHT_PX, intrinsics, look_at(place, middle))
    light, mask = objects.render(ray_caster((mesh.vertices, mesh.faces)), mesh, np.full((8, 8), 0.5, np.float32), 900.0, camera)
    return mask, (light / light[mask].mean(0)) * mask[..., None]  # but for the light, which comes from one side


@pytest.mark.parametrize("name", ["carton", "hexagon_tin"])
def test_an_object_looks_the_same_after_the_turn_of_its_print(objects, name):
    kind = objects.ALIKE_OBJECTS[name]
    mask, seen = take_photo(objects, kind, 20)
    apart = {}
    for turn_deg in (360 / kind.repeats, 180 / kind.repeats):
        turned_mask, turned = take_photo(objects, kind, 20 + turn_deg)
        apart[turn_deg] = (mask ^ turned_mask).sum() / mask.sum(), np.corrcoef(seen[mask].ravel(), turned[mask].ravel())[0, 1]
    (same_outline, same_print), (_, other_print) = apart.values()
    assert same_outline < 0.02 and same_print > 0.9 > 0.6 > other_print


def test_small_print_tells_repeats_apart_that_are_not_equal(objects):
    kind = objects.ALIKE_OBJECTS["tin"]
    equal, unlike = (objects.paint(replace(kind, equal=value), 1).astype(int) for value in (True, False))
    half = equal.shape[1] // 2
    assert (equal[:, :half] == equal[:, half:]).all()
    assert 5 < np.abs(unlike[:, :half] - unlike[:, half:]).mean() < objects.SMALL_PRINT_LEVELS


def test_meshes_are_closed(objects):
    for kind in objects.ALIKE_OBJECTS.values():
        mesh = objects.make_mesh(kind, 1)
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
        solid.merge_vertices(merge_tex=True, merge_norm=True)
        assert solid.is_watertight and solid.volume > 0
