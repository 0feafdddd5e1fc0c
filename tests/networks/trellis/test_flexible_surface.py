"""The mesh that is taken from the decoder's grid, on shapes whose distances are known."""

import numpy as np
import pytest

from helpers.solids import as_trimesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.networks.trellis.cube_patches import CORNERS, find_patches
from zeroshop_steps.networks.trellis.flexible_surface import ColoredSurface, CubeFeatures, extract_surface

RESOLUTION = 32


def grid_features(distance, resolution: int = RESOLUTION, band: float | None = None) -> CubeFeatures:
    """What a decoder that knows a signed distance would say: neutral weights, no displacement, colours by the sign of x."""
    places = np.stack(np.meshgrid(*[np.arange(resolution)] * 3, indexing="ij"), -1).reshape(-1, 3)
    if band is not None:  # as the decoder does: only cubes near the surface, here with what is inside, so that nothing is hollow
        places = places[distance((places + 0.5) / resolution - 0.5) < band]
    points = (places[:, None] + CORNERS) / resolution - 0.5
    colors = np.where(points[..., :1] > 0, [5.0, -5.0, -5.0], [-5.0, 5.0, -5.0])
    shape = len(places), 8
    return CubeFeatures(resolution, places, distance(points), np.zeros((*shape, 3)), colors, np.zeros((len(places), 21)))


def ball(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points - [0.02, -0.01, 0.015], axis=-1) - 0.35


def ring(points: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(points[..., 0], points[..., 1]) - 0.28, points[..., 2]) - 0.16


def edge_counts(faces: np.ndarray) -> np.ndarray:
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def volume(surface: ColoredSurface) -> float:
    a, b, c = surface.vertices[surface.faces].transpose(1, 0, 2)
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize(
    ("distance", "genus", "true_volume"), [(ball, 0, 4 / 3 * np.pi * 0.35**3), (ring, 1, 2 * np.pi**2 * 0.28 * 0.16**2)]
)
def test_analytic_shapes_are_closed_exact_and_face_outwards(distance, genus, true_volume):
    surface = extract_surface(grid_features(distance, band=0.06))
    assert (edge_counts(surface.faces) == 2).all()
    assert len(surface.vertices) - len(surface.faces) // 2 == 2 - 2 * genus
    assert np.abs(distance(surface.vertices)).max() < 0.05 / RESOLUTION * 4
    assert volume(surface) == pytest.approx(true_volume, rel=0.02)  # a mean of crossings lies inside a curved surface
    red = surface.vertices[:, 0] > 2 / RESOLUTION
    assert surface.colors[red, 0].min() > 0.9 and surface.colors[red, 1].max() < 0.1


def test_error_falls_with_the_square_of_the_grid():
    errors = [np.abs(ball(extract_surface(grid_features(ball, resolution)).vertices)).mean() for resolution in (16, 32)]
    assert errors[1] < 0.35 * errors[0]


def test_weights_move_vertices_within_their_cubes_and_displacements_move_the_grid():
    plain = grid_features(ball)
    rng = np.random.default_rng(0)
    weighed = CubeFeatures(*(*vars(plain).values(),)[:5], rng.normal(size=plain.weights.shape))
    moved = extract_surface(weighed)
    assert (edge_counts(moved.faces) == 2).all() and np.abs(ball(moved.vertices)).max() < 1 / RESOLUTION
    shifted = CubeFeatures(RESOLUTION, plain.places, plain.distances, np.full_like(plain.shifts, 0.5), plain.colors, plain.weights)
    offset = extract_surface(shifted).vertices - extract_surface(plain).vertices
    assert np.allclose(offset, np.tanh(0.5) / 2 / RESOLUTION)


def test_a_cube_is_split_along_the_larger_gammas():
    plain = grid_features(ball)
    weights = plain.weights.copy()
    weights[:, 20] = np.where(plain.places.sum(1) % 2 == 0, 4.0, -4.0)
    surface = extract_surface(CubeFeatures(*(*vars(plain).values(),)[:5], weights))
    cubes = np.floor((surface.vertices + 0.5) * RESOLUTION).astype(int)
    even = cubes.sum(1) % 2 == 0
    ends = np.sort(np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]]), axis=1)
    diagonals = ends[(np.abs(np.diff(cubes[ends], axis=1)[:, 0]).sum(1) == 2)]
    assert len(diagonals) > 1000 and even[diagonals].all(1).mean() > 0.99


@pytest.mark.parametrize("seed", range(8))
def test_any_pattern_of_signs_gives_a_manifold(seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(13, 13, 13))
    values[[0, -1]], values[:, [0, -1]], values[:, :, [0, -1]] = 1.0, 1.0, 1.0
    places = np.stack(np.meshgrid(*[np.arange(12)] * 3, indexing="ij"), -1).reshape(-1, 3)
    distances = values[tuple((places[:, None] + CORNERS).transpose(2, 0, 1))]
    zeros = np.zeros((len(places), 8, 3))
    surface = extract_surface(CubeFeatures(12, places, distances, zeros, zeros, np.zeros((len(places), 21))))
    assert len(surface.faces) > 1000 and (edge_counts(surface.faces) == 2).all()
    mesh = as_trimesh(Mesh(surface.vertices, surface.faces))
    assert mesh.is_watertight and mesh.is_winding_consistent


def test_patches_of_opposite_corners_are_apart_and_joined_where_flipped():
    inside = 0b00001001  # corners 0 and 3: the diagonal of the lower face
    assert sorted(set(find_patches(inside, 0))) == [-1, 0, 1]
    assert sorted(set(find_patches(inside, 1 << 4))) == [-1, 0]


def test_nothing_inside_is_no_surface():
    surface = extract_surface(grid_features(lambda points: np.ones(points.shape[:-1]), resolution=4))
    assert surface.faces.shape == (0, 3) and surface.vertices.shape == (0, 3)
