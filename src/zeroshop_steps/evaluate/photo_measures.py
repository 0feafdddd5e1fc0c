"""How well a mesh agrees with the photos that it was made from.

Every photo is held out once: at points of the surface, its colours are compared with those that the other photos predict. (A real
capture has no photos to spare, and a texture that was baked from all of them would hide the error.) If the surface is in the wrong
place, each photo shows a different spot of the object at the point, and the colours disagree. Highlights make them disagree on a
right surface, too. So a point counts as displaced only if another depth along its normal explains the same photos clearly better, and
not for itself alone, where one of many depths may by chance, but together with the surface around it (cost aggregation, as in stereo).
This finds the lid of a visual hull over a bowl, whose silhouettes are perfect (Kutulakos and Seitz 2000, photo-consistency; Collins
1996, plane sweep).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.finish.texturing import exposure_gains
from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import shrink_camera
from zeroshop_steps.geometry.meshes.surface_fields import build_neighbour_matrix, smooth, weld
from zeroshop_steps.geometry.meshes.triangle_meshes import SAME_SIDE_COSINE, Mesh, diameter_of
from zeroshop_steps.geometry.observation.visibility import SHOWING_COSINE, VISIBLE_SHARE, compute_view_maps, find_visible, sample_image
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer, RayHits
from zeroshop_steps.register.scene.image_set import REFERENCE_PX
from zeroshop_steps.runtime.errors import StepError

SAMPLES = 6000  # points of the surface; the shares are then known to about one per cent
LEAST_VIEWS = 3  # photos that must see a point for it to count; two can agree by chance
MIN_TRUST = 0.1  # of 1 (geometry/observation/visibility.py); closer to an edge a pixel may show something else
OFFSETS_DIAMETERS = np.r_[-0.30:-0.019:0.02, 0.02:0.081:0.02]  # tried depths along the normal, outwards positive; hollows are deep
AROUND = 32  # points of the surface that are judged together
MARGIN, SHIFT_PX = 0.015, 0.5  # of the colour, 0 to 1: another depth must be better by this, and by what such a shift changes


@dataclass(frozen=True)
class PhotoAgreement:
    """Agreement of a mesh with its photos.

    Attributes:
        silhouette_agreement: intersection over union of silhouette and mask, mean over the photos.
        back_share: share of the mesh's pixels that show its back, through a hole or a torn part.
        photometric_error: mean difference between a photo's colour and the prediction by the others, 0 to 1.
        displaced_share: share of the judged surface where another depth explains the photos clearly better.
        judged_share: share of the surface that enough photos see for these two measures.
    """

    silhouette_agreement: float
    back_share: float
    photometric_error: float
    displaced_share: float
    judged_share: float


@dataclass(frozen=True)
class ShrunkView(View):
    """A view with an image and a mask that are shrunk to the size of its camera."""

    original: View

    def image(self) -> np.ndarray:
        """(height, width, 3) uint8 sRGB."""
        return cv2.resize(self.original.image(), (self.camera.width_px, self.camera.height_px), interpolation=cv2.INTER_AREA)

    def mask(self) -> np.ndarray:
        """(height, width) bool, True where the object covers at least half of the pixel."""
        mask = self.original.mask().astype(np.uint8) * 255
        return cv2.resize(mask, (self.camera.width_px, self.camera.height_px), interpolation=cv2.INTER_AREA) >= 128


def measure_photo_agreement(mesh: Mesh, views: Sequence[View]) -> PhotoAgreement:
    """Compare a mesh with photos.

    Args:
        mesh: the surface.
        views: registered photos with masks, cameras in the frame of the mesh.

    Raises:
        StepError: a mask is empty.
    """
    views = [_shrink(view) for view in views]
    joined, _ = weld(mesh)
    # The normals are the directions in which other depths are tried.
    normals = smooth(joined.vertex_normals, build_neighbour_matrix(joined), 6)
    points, faces, _ = sample_surface(joined, SAMPLES, np.random.default_rng(0))
    normals = normals[joined.faces[faces]].sum(1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    diameter = diameter_of(joined)
    places = points + OFFSETS_DIAMETERS[:, None, None] * diameter * normals
    places = np.concatenate([points[None], places])
    look = _sample_photos(joined, places, normals, views, diameter)
    weight, colors = look.weight, look.colors * exposure_gains.estimate_gains(look.colors[0].mean(2), look.weight, look.weight > 0)[:, None]
    spread = np.stack([_measure_spread(shown, weight) for shown in colors])
    spread[1:][~(look.on_object[1:] | (weight == 0)).all(2)] = np.inf
    slope = (look.slope * weight).sum(1) / np.maximum(weight.sum(1), 1e-12)
    judged = (weight > 0).sum(1) >= LEAST_VIEWS
    return PhotoAgreement(
        silhouette_agreement=float(np.mean(look.iou)),
        back_share=look.back_px / max(look.mesh_px, 1),
        photometric_error=_measure_left_out_error(colors[0], weight, judged),
        displaced_share=_measure_displaced_share(points[judged], normals[judged], spread[:, judged], slope[judged]),
        judged_share=float(judged.mean()),
    )


@dataclass(frozen=True)
class _PhotoSamples:
    """What V photos show at N points, each in P places along its normal; the first place is the point itself.

    Attributes:
        colors: (P, N, V, 3) blurred colours, 0 to 1.
        on_object: (P, N, V) bool, whether the place is inside the photo's mask.
        weight: (N, V) cosine between normal and direction to the camera where the photo sees the point, else 0.
        slope: (N, V) change of colour over one pixel at the point.
        iou: V intersections over union of silhouette and mask.
        back_px, mesh_px: number of pixels that show the back of the mesh, and of those that show the mesh.
    """

    colors: np.ndarray
    on_object: np.ndarray
    weight: np.ndarray
    slope: np.ndarray
    iou: list[float]
    back_px: int
    mesh_px: int


def _sample_photos(mesh: Mesh, places: np.ndarray, normals: np.ndarray, views: Sequence[View], diameter: float) -> _PhotoSamples:
    renderer, corners, facing = MeshRenderer(mesh), mesh.vertices[mesh.faces[:, 0]], mesh.face_normals()
    shape = (*places.shape[:2], len(views))
    colors, on_object = np.empty((*shape, 3), np.float32), np.empty(shape, bool)
    weight, slope = np.empty(shape[1:], np.float32), np.empty(shape[1:], np.float32)
    iou, back_px, mesh_px = [], 0, 0
    for k, view in enumerate(views):
        mask, hits = view.mask(), renderer.cast_rays(view.camera)
        if not mask.any():
            raise StepError(f"{view.mask_path}: the mask shows no object; make the mask again, or leave the photo out")
        iou.append(float((mask & hits.mask).sum() / (mask | hits.mask).sum()))
        back_px, mesh_px = back_px + _count_back_pixels(corners, facing, hits, view), mesh_px + int(hits.mask.sum())
        maps = compute_view_maps(view.camera, mask, hits.depth, diameter)
        pixels, depth = view.camera.project(places[0])
        towards = view.camera.centre_in_world - places[0]
        cosine = np.einsum("ij,ij->i", normals, towards) / np.linalg.norm(towards, axis=1)
        seen = (
            find_visible(pixels, depth, hits.depth, VISIBLE_SHARE * diameter)
            & (cosine > SHOWING_COSINE)
            & (sample_image(maps.trust, pixels) > MIN_TRUST)
        )
        weight[:, k] = np.where(seen, cosine, 0.0)
        # So that print that is a pixel off does not count as another colour.
        image = cv2.GaussianBlur(view.image().astype(np.float32) / 255.0, (0, 0), 2.0)
        slope[:, k] = sample_image(_measure_slope(image), pixels)
        for place, moved in enumerate(places):
            pixels, _ = view.camera.project(moved)
            colors[place, :, k] = sample_image(image, pixels)
            # All of the mask's four pixels around a point must show the object.
            on_object[place, :, k] = sample_image(mask, pixels) > 0.99
    return _PhotoSamples(colors, on_object, weight, slope, iou, back_px, mesh_px)


def _count_back_pixels(corners: np.ndarray, normals: np.ndarray, hits: RayHits, view: View) -> int:
    """How many pixels show the back of their face, by (F, 3) one corner and the normal of each face."""
    shown, count = np.unique(hits.face[hits.mask], return_counts=True)
    towards = view.camera.centre_in_world - corners[shown]
    return int(count[np.einsum("ij,ij->i", normals[shown], towards) < 0].sum())


def _measure_slope(image: np.ndarray) -> np.ndarray:
    """(height, width) change of colour over one pixel, in the channel that changes most."""
    x, y = (cv2.Sobel(image, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    # By planes: a maximum over three values that are neighbours in memory is slow.
    return np.maximum.reduce(cv2.split(np.hypot(x, y)))


def _measure_spread(colors: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(N,) weighted root mean square distance of (N, V, 3) colours to their mean, in the channel that differs most."""
    total = np.maximum(weight.sum(1), 1e-12)
    mean = np.einsum("nv,nvc->nc", weight, colors) / total[:, None]
    distance = np.abs(colors - mean[:, None]).max(2)
    return np.sqrt((weight * distance**2).sum(1) / total)


def _measure_displaced_share(points: np.ndarray, normals: np.ndarray, spread: np.ndarray, slope: np.ndarray) -> float:
    """Share of points where another place than the first explains the photos clearly better, together with those around; 1 of no points.

    Args:
        points, normals: (N, 3) of the surface.
        spread: (P, N) of the colours at P places along each normal, inf where a place is off the object.
        slope: (N,) change of colour over one pixel.
    """
    if not len(points):
        return 1.0
    _, near = cKDTree(points).query(points, min(AROUND, len(points)))
    near = near.reshape(len(points), -1)
    same = np.einsum("nd,nkd->nk", normals, normals[near]) > SAME_SIDE_COSINE
    count = same.sum(1)
    best = np.full(len(points), -np.inf)
    for place in spread[1:]:
        use = same & np.isfinite(place[near])
        better = np.where(use, spread[0][near] - place[near], 0.0).sum(1) / np.maximum(use.sum(1), 1)
        best = np.where(2 * use.sum(1) >= count, np.maximum(best, better), best)
    return float((best > MARGIN + SHIFT_PX * (slope[near] * same).sum(1) / count).mean())


def _measure_left_out_error(colors: np.ndarray, weight: np.ndarray, judged: np.ndarray) -> float:
    """Mean difference between each photo's colour and the mean of the others; 1 if no point is judged."""
    total = np.einsum("nv,nvc->nc", weight, colors)[:, None] - weight[:, :, None] * colors
    others = total / np.maximum(weight.sum(1)[:, None] - weight, 1e-12)[:, :, None]
    error = np.abs(colors - others).max(2)
    use = (weight > 0) & judged[:, None]
    return float(error[use].mean()) if use.any() else 1.0


def _shrink(view: View) -> View:
    if max(view.camera.width_px, view.camera.height_px) <= REFERENCE_PX:
        return view
    return ShrunkView(shrink_camera(view.camera, REFERENCE_PX), view.image_path, view.mask_path, view)
