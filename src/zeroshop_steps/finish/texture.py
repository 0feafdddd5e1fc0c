"""Bake the texture from the undistorted photos.

Each spot of the surface takes its detail from the photo that sees it best (view angle, resolution, distance to
occlusion edges), with short soft transitions, so print stays sharp. Its broad colour comes from all photos that see
it, highlights weighed down, so no seam shows where the best photo changes. Spots that no photo sees are filled
smoothly from their surroundings.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from scipy.sparse import csr_matrix

from zeroshop_steps.finish import exposure
from zeroshop_steps.finish.atlas import fill_gutters, rasterize_atlas
from zeroshop_steps.finish.unwrap import check_texture_size
from zeroshop_steps.geometry.images import write_image
from zeroshop_steps.geometry.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.meshes import Mesh, read_ply
from zeroshop_steps.geometry.registered_views import View, read_views
from zeroshop_steps.geometry.surface_fields import build_neighbour_matrix, fill_harmonically, smooth, weld
from zeroshop_steps.geometry.visibility import ViewMaps, compute_view_maps, find_visible, rate_vertex_views, sample_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json

SELECT_POWER = 12.0  # how sharply the best photo wins
QUALITY_SMOOTHING = 6  # steps over the mesh: keeps regions of one photo large
LEVEL_SMOOTHING = 12  # steps over the mesh: what is broader than this is averaged over photos
HIGHLIGHT = 0.06  # colours this far (of 1) from what the other photos show weigh half


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method\'s command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="unwrapped mesh, registration frame")
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras with undistorted images and masks")
    parser.add_argument("--texture-size", type=int, default=2048, help="side of the square texture in texels")
    parser.add_argument("--out", type=Path, required=True, help="texture PNG; its figures go beside it as .json")


def run(args: argparse.Namespace) -> None:
    check_texture_size(args.texture_size)
    start_s = time.monotonic()
    mesh = read_ply(args.mesh)
    if mesh.uv is None:
        raise StepError(f"{args.mesh} has no texture_u and texture_v; unwrap it first")
    views, _ = read_views(args.cameras)
    texture, figures = bake_texture(mesh, views, args.texture_size)
    write_image(args.out, texture)
    figures |= {"parameters": {"texture_size": args.texture_size}, "seconds": round(time.monotonic() - start_s, 2)}
    write_json(args.out.with_suffix(".json"), figures)
    print(f"texture: {figures['seen_share']:.1%} of the surface seen, {figures['seconds']} s", file=sys.stderr)


def bake_texture(mesh: Mesh, views: list[View], size: int) -> tuple[np.ndarray, dict]:
    """Bake a (size, size, 3) uint8 texture for an unwrapped `mesh` in the frame of the views' cameras; see the module's text."""
    joined, index = weld(mesh)
    extent = float(np.linalg.norm(np.ptp(joined.vertices, axis=0)))
    renderer = MeshRenderer(joined)
    neighbours = build_neighbour_matrix(joined)
    normals = smooth(joined.normals, neighbours, 2)
    joined = Mesh(joined.vertices, joined.faces, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))
    maps = [compute_view_maps(view, renderer.cast_rays(view.camera), extent) for view in views]
    images = [view.image().astype(np.float32) / 255.0 for view in views]
    texels = rasterize_atlas(mesh, size)
    if len(texels.face) == 0:
        raise StepError("the unwrapped mesh covers no texel; unwrap it again, or choose a larger --texture-size")
    count = len(texels.face)
    # (N, V): what belongs to the corners of a texel's face, at the texel.
    at_texels = csr_matrix(
        (texels.barycentric.ravel(), index[mesh.faces[texels.face]].ravel(), np.arange(0, 3 * count + 1, 3)), (count, len(joined.vertices))
    )

    quality = rate_vertex_views(joined, maps, extent)
    images, gains = _equalize_exposure(images, quality, joined, maps)
    broad, corrections = _average_colors(images, quality, joined, maps, neighbours)
    choice = _choose_photos(quality, neighbours)
    color, weight = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    points = at_texels @ joined.vertices
    for threshold, needed in ((0.02, None), (0.0, 0.05)):  # the second round is for texels that the chosen photos miss
        pending = np.arange(count) if needed is None else np.flatnonzero(weight < needed)
        at_pending, votes = at_texels[pending], choice if needed is None else quality
        for k, view in enumerate(maps):
            share = at_pending @ votes[:, k]
            chosen = share > threshold
            use = pending[chosen]
            pixels, depth = view.camera.project(points[use])
            strength = share[chosen] * sample_image(view.trust, pixels) * find_visible(pixels, depth, view.depth, 0.004 * extent)
            use, pixels, strength = use[strength > 0], pixels[strength > 0], strength[strength > 0]
            level = at_texels[use] @ corrections[:, k]
            color[use] += strength[:, None] * (sample_image(images[k], pixels) + level)
            weight[use] += strength
    filled = at_texels @ broad
    color = (color + 1e-4 * filled) / (weight + 1e-4)[:, None]
    texture = np.zeros((size, size, 3), np.uint8)
    texture[texels.row, texels.column] = np.clip(np.rint(color * 255.0), 0, 255)
    figures = {"texels": count, "seen_share": round(float((weight > 0).mean()), 5), "gains": [round(float(g), 4) for g in gains]}
    return fill_gutters(texture, texels), figures


def _equalize_exposure(
    images: list[np.ndarray], quality: np.ndarray, mesh: Mesh, maps: list[ViewMaps]
) -> tuple[list[np.ndarray], np.ndarray]:
    """The images without differences of exposure, and the factor of each."""
    factors = exposure.estimate_gains(_sample_vertex_colors(images, mesh, maps).mean(2), quality, quality > 0.05)
    return [image * factor for image, factor in zip(images, factors, strict=True)], factors


def _average_colors(
    images: list[np.ndarray], quality: np.ndarray, mesh: Mesh, maps: list[ViewMaps], neighbours
) -> tuple[np.ndarray, np.ndarray]:
    """The colour that all photos agree on at each vertex, and what each photo lacks to it.

    Returns:
        broad: (V, 3) robust mean over photos, filled where no photo sees the vertex.
        corrections: (V, K, 3) smooth difference of the mean and photo k's own colour.
    """
    colors = _sample_vertex_colors(images, mesh, maps)
    weights = quality.copy()
    for _ in range(4):
        mean = np.einsum("vk,vkc->vc", weights, colors) / np.maximum(weights.sum(1), 1e-12)[:, None]
        distance = np.linalg.norm(colors - mean[:, None], axis=2)
        weights = quality / (1.0 + (distance / HIGHLIGHT) ** 2)
    broad = fill_harmonically(mean, quality.max(1) > 1e-3, neighbours)
    corrections = np.empty_like(colors)
    for k in range(len(maps)):
        corrections[:, k] = smooth(mean - colors[:, k], neighbours, LEVEL_SMOOTHING, np.minimum(quality[:, k], 0.05))
    return broad, corrections


def _sample_vertex_colors(images: list[np.ndarray], mesh: Mesh, maps: list[ViewMaps]) -> np.ndarray:
    blurred = (cv2.GaussianBlur(image, (0, 0), 1.5) for image in images)
    return np.stack([sample_image(image, view.camera.project(mesh.vertices)[0]) for image, view in zip(blurred, maps, strict=True)], 1)


def _choose_photos(quality: np.ndarray, neighbours) -> np.ndarray:
    """(V, K) share of each photo in a vertex's detail: a sharp but smooth vote for the best one."""
    calm = smooth(quality, neighbours, QUALITY_SMOOTHING)
    share = (calm / np.maximum(calm.max(1, keepdims=True), 1e-12)) ** SELECT_POWER
    return share / np.maximum(share.sum(1, keepdims=True), 1e-12)
