"""Unwrap the closed mesh, bake its texture from the undistorted photos, and write the finished mesh in the object frame.

The detail at a spot comes from the photo that sees it best (view angle, resolution, distance to occlusion edges), with short
soft transitions, so print stays sharp. A photo that shows a highlight there, brighter than the other photos do, has less say. The
broad colour is a mean of all photos that see the spot, with little weight for highlights, so no seam shows where the best photo
changes. Spots that no photo sees are filled smoothly from around them, or take the colour of a generated mesh, whose difference
from the photos is smoothed in the same way.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from scipy.sparse import csr_matrix

from zeroshop_steps.finish.export import make_metadata, move_to_object_frame, read_stages, summarize_product, write_product
from zeroshop_steps.finish.texturing import exposure_gains
from zeroshop_steps.finish.texturing.atlas import Texels, fill_gutters, rasterize_atlas
from zeroshop_steps.finish.texturing.texel_colors import VotingView, make_texel_colors
from zeroshop_steps.finish.texturing.unwrap import check_texture_size, measure_atlas_use, unwrap_mesh
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.imaging.images import BLUR_PX
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.surface_fields import (
    BROAD_SMOOTHING,
    LIGHT_SMOOTHING,
    build_neighbour_matrix,
    fill_harmonically,
    smooth,
    smooth_normals,
    weld,
)
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visibility import VISIBLE_SHARE, ViewMaps, compute_view_maps, rate_vertex_views, sample_image
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.compute.kernel_devices import DEVICES, choose_kernel_device
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

# A step of smoothing averages over direct neighbours, so its reach grows with the edges of the mesh.
QUALITY_SMOOTHING = 6  # steps; regions that take their detail from one photo become larger
SELECT_POWER = 12.0  # of the quality; at 12, a photo of 90 % of the best one's quality gets 28 % of its weight
HIGHLIGHT_ROUNDS = 4  # the mean and the weights are computed in turns
HIGHLIGHT = 0.06  # difference of colour (of 1) from the mean at which a photo's weight is half
GLARE = 0.03  # of 1, by which a photo is brighter than the mean where it counts half as a source of detail
LEAST_QUALITY = 0.05  # of the best view: less counts neither for exposure nor for the level, and leaves a texel to any photo
SEEN_QUALITY = 1e-3  # below, no photo shows a vertex and its colour is filled in
CHOSEN_SHARE = 0.02  # of a texel's detail; photos with less are not looked up
FILL_WEIGHT = 1e-4  # of the broad colour: decides only where no photo does


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="closed mesh, registration frame")
    parser.add_argument("--frame", type=Path, required=True, help="frame.json")
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras with undistorted images and masks")
    parser.add_argument("--generated", type=Path, nargs="?", help="generated mesh with colours, registration frame, if there is one")
    parser.add_argument(
        "--stages", type=Path, nargs="*", default=[], help="JSONs of earlier steps, whose seconds and parameters are copied"
    )
    parser.add_argument("--texture-size", type=int, default=2048, help="side of the square texture in texels (default: %(default)s)")
    parser.add_argument(
        "--device", choices=DEVICES, default="cpu", help="where the mesh is rasterized and texels get their colours (default: %(default)s)"
    )
    parser.add_argument("--out", type=Path, required=True, help="mesh.ply; .png, .glb and .json are written beside it")


def run(args: argparse.Namespace) -> None:
    """Write one finished mesh."""
    check_texture_size(args.texture_size)
    device = choose_kernel_device(args.device)
    frame, stages = read_json(args.frame), read_stages([*args.stages, args.frame])
    parameters = {"texture_size": args.texture_size}
    start_s = time.monotonic()
    mesh, charts = unwrap_mesh(read_ply(args.mesh), args.texture_size)
    atlas_use = round(measure_atlas_use(mesh), 4)
    unwrapped_s = time.monotonic()
    stages["unwrapped"] = {"parameters": parameters, "seconds": round(unwrapped_s - start_s, 2)}
    views, _ = read_views(args.cameras)
    generated = read_colored(args.generated) if args.generated else None
    texture, figures = bake_texture(mesh, views, args.texture_size, generated, device)
    stages["texture"] = {"parameters": parameters, "seconds": round(time.monotonic() - unwrapped_s, 2)}
    product = move_to_object_frame(mesh, np.array(frame["object_from_registration"]), texture)
    facts = make_metadata(product, frame, stages) | {"charts": charts, "atlas_use": atlas_use, "texture": figures | {"device": device}}
    write_product(args.out, product, facts)
    print(f"texture: {charts} charts, {atlas_use:.0%} used, {figures['seen_share']:.1%} of the surface seen", file=sys.stderr)
    print(f"texture: {args.out} {summarize_product(product, frame)}", file=sys.stderr)


def read_colored(path: Path) -> Mesh:
    """A mesh with colours at its vertices. Raises StepError where it has none."""
    mesh = read_ply(path)
    if mesh.colors is None:
        raise StepError(f"{path} has no colours (red, green and blue) at its vertices; make it again with the surface method trellis")
    return mesh


def bake_texture(mesh: Mesh, views: list[View], size: int, generated: Mesh | None = None, device: str = "cpu") -> tuple[np.ndarray, dict]:
    """Bake the texture of an unwrapped mesh, as the module describes.

    Args:
        mesh: in the frame of the views' cameras.
        views: registered photos with masks.
        size: side of the texture in texels.
        generated: with colours at its vertices, for what no photo sees.
        device: cpu, cuda or auto, as in `make_texel_colors`.

    Returns:
        texture: (size, size, 3) uint8.
        figures: for the JSON.

    Raises:
        StepError: no texel shows the mesh.
    """
    joined, index = weld(mesh)
    extent = float(np.linalg.norm(np.ptp(joined.vertices, axis=0)))
    renderer = MeshRenderer(joined, choose_kernel_device(device))
    neighbours = build_neighbour_matrix(joined)
    joined = Mesh(joined.vertices, joined.faces, smooth_normals(joined, neighbours, LIGHT_SMOOTHING))
    images, maps = map(list, zip(*(_look_at_mesh(view, renderer, extent) for view in views), strict=True))
    texels = _rasterize(mesh, size)

    quality = rate_vertex_views(joined, maps, extent)
    colors = _sample_vertex_colors(images, joined, maps)
    gains = exposure_gains.estimate_gains(colors.mean(2), quality, quality > LEAST_QUALITY)
    colors *= gains[:, None]
    guess = None if generated is None else find_nearest_colors(generated, joined.vertices)
    broad, corrections, glare = _average_colors(colors, quality, neighbours, guess)
    choice = _choose_photos(quality / (1.0 + (glare / GLARE) ** 2), neighbours)
    corners = index.astype(np.int32)[mesh.faces][texels.face]
    texel_colors = make_texel_colors(device, corners, texels.barycentric, joined.vertices, VISIBLE_SHARE * extent)
    # The second round is for texels that the chosen photos miss.
    for votes, least_votes, covered in ((choice, CHOSEN_SHARE, np.inf), (quality, 0.0, LEAST_QUALITY)):
        texel_colors.begin_round(least_votes, covered)
        for k, view in enumerate(maps):
            projection = view.camera.intrinsics @ view.camera.camera_from_world[:3]
            at_vertices = (np.ascontiguousarray(values[:, k], np.float32) for values in (votes, corrections))
            image = _to_float(images[k], gains[k])
            texel_colors.add(VotingView(projection, image, view.trust, view.depth, *at_vertices))
    texture = np.zeros((size, size, 3), np.uint8)
    texture[texels.row, texels.column], weight = texel_colors.finish(broad.astype(np.float32), FILL_WEIGHT)
    seen_share = round(float((weight > 0).mean()), 5)
    figures = {"texels": len(weight), "seen_share": seen_share, "gains": [round(float(g), 4) for g in gains]}
    if guess is not None:
        figures["generated_share"] = round(1.0 - seen_share, 5)
    return fill_gutters(texture, texels), figures


def _look_at_mesh(view: View, renderer: MeshRenderer, extent: float) -> tuple[np.ndarray, ViewMaps]:
    """The part of a photo around the mesh, (height, width, 3) uint8, and what it sees there."""
    window, camera = renderer.find_window(view.camera)
    maps = compute_view_maps(camera, view.mask()[window], renderer.find_depth(camera), extent)
    return view.image()[window].copy(), maps


def _to_float(image: np.ndarray, gain: float = 1.0) -> np.ndarray:
    """An image as float32 from 0 to the gain. All photos of a capture would take several gigabytes as such."""
    return np.multiply(image, np.float32(gain / 255.0), dtype=np.float32)


def bake_colors(mesh: Mesh, colored: Mesh, size: int) -> np.ndarray:
    """(size, size, 3) uint8 texture of an unwrapped mesh with the colours of another one's vertices.

    Each texel takes the colour at the nearest place of the coloured surface, interpolated between the corners of the face there, so
    that the texture is as fine as the coloured mesh, even where the unwrapped one is coarser.

    Args:
        mesh: unwrapped.
        colored: with colours at its vertices, in the same frame and nearly the same shape.
        size: side of the texture in texels.

    Raises:
        StepError: no texel shows the mesh.
    """
    texels = _rasterize(mesh, size)
    points = np.einsum("nk,nkd->nd", texels.barycentric, mesh.vertices[mesh.faces[texels.face]])
    texture = np.zeros((size, size, 3), np.uint8)
    texture[texels.row, texels.column] = np.clip(np.rint(find_nearest_colors(colored, points) * 255.0), 0, 255)
    return fill_gutters(texture, texels)


def _rasterize(mesh: Mesh, size: int) -> Texels:
    texels = rasterize_atlas(mesh, size)
    if len(texels.face) == 0:
        raise StepError("the unwrapped mesh covers no texel; unwrap it again, or choose a larger --texture-size")
    return texels


def _average_colors(
    colors: np.ndarray, quality: np.ndarray, neighbours: csr_matrix, guess: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mean colour of all photos at each vertex, and by how much each photo differs from it.

    Args:
        colors: (V, K, 3) of the vertices in K photos, with equal exposure.
        quality: (V, K) how well a photo sees a vertex.
        neighbours: of the vertices, as `smooth` takes them.
        guess: (V, 3) for what no photo sees.

    Returns:
        broad: (V, 3) robust mean over the photos; filled in where no photo sees the vertex.
        corrections: (V, K, 3) smoothed difference between the mean and the colour in photo k.
        glare: (V, K) by how much photo k is brighter than the mean; not below 0.
    """
    weights = quality.copy()
    for _ in range(HIGHLIGHT_ROUNDS):
        mean = np.einsum("vk,vkc->vc", weights, colors) / np.maximum(weights.sum(1), 1e-12)[:, None]
        distance = np.linalg.norm(colors - mean[:, None], axis=2)
        weights = quality / (1.0 + (distance / HIGHLIGHT) ** 2)
    # With a guess, what is filled in is by how much it differs: its own detail stays, and no seam shows where the photos end.
    offset = np.zeros_like(mean) if guess is None else guess
    broad = offset + fill_harmonically(mean - offset, quality.max(1) > SEEN_QUALITY, neighbours)
    corrections = np.empty_like(colors)
    for k in range(colors.shape[1]):
        corrections[:, k] = smooth(mean - colors[:, k], neighbours, BROAD_SMOOTHING, np.minimum(quality[:, k], LEAST_QUALITY))
    return broad, corrections, np.maximum((colors - mean[:, None]).mean(2), 0.0)


def find_nearest_colors(colored: Mesh, points: np.ndarray) -> np.ndarray:
    """(N, 3) float32 colours from 0 to 1 of a mesh with colours at its vertices, at its nearest places to (N, 3) points."""
    assert colored.colors is not None
    found = ray_caster((colored.vertices, colored.faces)).compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
    second, third = found["primitive_uvs"].numpy().T[:, :, None]
    corners = colored.colors[colored.faces[found["primitive_ids"].numpy().astype(np.int64)]].astype(np.float32) / 255.0
    return corners[:, 0] * (1.0 - second - third) + corners[:, 1] * second + corners[:, 2] * third


def _sample_vertex_colors(images: list[np.ndarray], mesh: Mesh, maps: list[ViewMaps]) -> np.ndarray:
    """(V, K, 3) float32 colours of the vertices in K photos, 0 to 1."""
    blurred = (cv2.GaussianBlur(_to_float(image), (0, 0), BLUR_PX) for image in images)
    return np.stack([sample_image(image, view.camera.project(mesh.vertices)[0]) for image, view in zip(blurred, maps, strict=True)], 1)


def _choose_photos(quality: np.ndarray, neighbours: csr_matrix) -> np.ndarray:
    """(V, K) share of each photo in the detail at a vertex: nearly all for the best one, with smooth transitions."""
    calm = smooth(quality, neighbours, QUALITY_SMOOTHING)
    share = (calm / np.maximum(calm.max(1, keepdims=True), 1e-12)) ** SELECT_POWER
    return share / np.maximum(share.sum(1, keepdims=True), 1e-12)
