"""Smoothing of meshes."""

import numpy as np
import pytest
import trimesh

from zeroshop_steps.geometry.meshes.smoothing import TAUBIN_LAMBDA, TAUBIN_MU, smooth_taubin
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh


def ball(subdivisions: int) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions)
    return Mesh(np.array(sphere.vertices), np.array(sphere.faces, np.int64))


def sheet(cells: int) -> Mesh:
    """A flat square with a border, of unit cells cut along one diagonal."""
    rows, columns = np.mgrid[: cells + 1, : cells + 1]
    vertices = np.stack([columns, rows, np.zeros_like(rows)], 2).reshape(-1, 3).astype(float)
    corner = (rows[:-1, :-1] * (cells + 1) + columns[:-1, :-1]).ravel()
    right, up = corner + 1, corner + cells + 1
    return Mesh(vertices, np.concatenate([np.stack([corner, right, up], 1), np.stack([right, up + 1, up], 1)]))


def average_slowly(mesh: Mesh, vertices: np.ndarray, share: float) -> np.ndarray:
    """One step, as its text says: a loop over vertices."""
    faces_at: dict[frozenset, int] = {}
    for face in mesh.faces:
        for edge in (face[[0, 1]], face[[1, 2]], face[[2, 0]]):
            key = frozenset(edge.tolist())
            faces_at[key] = faces_at.get(key, 0) + 1
    moved = vertices.copy()
    for vertex in range(len(vertices)):
        edges = [edge for edge in faces_at if vertex in edge]
        border = [edge for edge in edges if faces_at[edge] == 1]
        neighbors = [next(iter(edge - {vertex})) for edge in border or edges]
        if neighbors:
            moved[vertex] += share * (vertices[neighbors].mean(0) - vertices[vertex])
    return moved


@pytest.mark.parametrize("mesh", [ball(1), sheet(4)], ids=["closed", "open"])
def test_smoothing_moves_each_vertex_towards_its_neighbours(mesh):
    noisy = Mesh(mesh.vertices + np.random.default_rng(0).normal(0, 0.1, mesh.vertices.shape), mesh.faces)
    expected = average_slowly(mesh, average_slowly(mesh, noisy.vertices, TAUBIN_LAMBDA), TAUBIN_MU)
    assert np.allclose(smooth_taubin(noisy, 1).vertices, expected)


def test_smoothing_keeps_size_straight_borders_and_vertices_without_faces():
    sphere = ball(4)
    radius = np.linalg.norm(smooth_taubin(sphere, 30).vertices, axis=1)
    assert radius.mean() == pytest.approx(1.0, abs=0.005)
    square = sheet(20)
    loose = Mesh(np.vstack([square.vertices, [[7.0, 8.0, 9.0]]]), square.faces)
    smoothed = smooth_taubin(loose, 30).vertices
    assert np.allclose(smoothed[-1], [7.0, 8.0, 9.0])
    middle = np.isin(loose.vertices[:, 0], np.arange(5, 16)) & (loose.vertices[:, 1] == 0)
    assert np.abs(smoothed[middle, 1]).max() < 0.02, "a straight border stays where it is, away from its corners"
