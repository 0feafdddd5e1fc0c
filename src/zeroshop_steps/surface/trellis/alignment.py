"""Bring a generated mesh into the frame of the photos' cameras by a similarity.

The masks' visual hull, coloured by the photos, is where the search starts: from all rotations, by shape and print (`bop.align` aligns
meshes with their true models in the same way). The candidates are then moved until their outlines lie on those of the masks, and the
best of them in small steps until outlines and colours fit no better.
"""

from collections.abc import Sequence

import numpy as np

from zeroshop_steps.geometry.alignment.similarity_icp import SAMPLES, SimilarityRefiner
from zeroshop_steps.geometry.alignment.similarity_search import apply_steps, search_similarities, solve_steps
from zeroshop_steps.geometry.alignment.surface_points import SurfacePoints, sample_surface_points
from zeroshop_steps.geometry.cameras.object_crops import fit_object_sphere
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import compute_scale
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visibility import SHOWING_COSINE
from zeroshop_steps.geometry.observation.visual_hull import COARSE_VOXELS, VisualHull
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.trellis.photo_fit import ComparedPhoto, PhotoComparison, PhotoFit, middle_of, shrink_photo

OUTLINE_STEPS = 12
FIRST_STEP = np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02, 0.02])
"""Radians, shares of the object's size, and growth, of the first of the small steps; each round without gain halves them."""
HALVINGS = 5


class PhotoAligner:
    """Photos of an object, and the hull of their masks, with which meshes are aligned.

    Raises:
        StepError: the masks have nothing in common.
    """

    def __init__(self, cameras: Sequence[Camera], images: Sequence[np.ndarray], masks: Sequence[np.ndarray], seed: int = 0) -> None:
        self.photos = [shrink_photo(*parts) for parts in zip(cameras, images, masks, strict=True)]
        self.seed = seed
        small = [photo.camera for photo in self.photos]
        sphere = fit_object_sphere(cameras, masks)
        hull = VisualHull.carve([sphere.normalized(camera) for camera in small], [photo.mask for photo in self.photos], 1.1, COARSE_VOXELS)
        points, normals = hull.surface()
        if len(points) < SAMPLES // 40:
            raise StepError("the masks have nothing in common: no point lies inside of all; check masks and cameras")
        chosen = np.random.default_rng(seed).permutation(len(points))[:SAMPLES]
        points, normals = points[chosen] * sphere.radius + sphere.centre, normals[chosen]
        self.size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self.hull = SurfacePoints(points, normals, color_points(points, normals, self.photos))

    def align(self, mesh: Mesh) -> PhotoFit:
        """The best similarity of a mesh with colours at its vertices, and how well the photos then agree with it."""
        source = sample_surface_points(mesh, SAMPLES, np.random.default_rng(self.seed))
        candidates = SimilarityRefiner(source, self.hull).choose_best(search_similarities(source, self.hull))
        comparison = PhotoComparison(mesh, self.photos)
        fits = [comparison.measure(self._fit_outlines(mesh, comparison, candidate.transform)) for candidate in candidates]
        return self._fit_in_small_steps(mesh, comparison, min(fits, key=lambda fit: fit.error))

    def _fit_outlines(self, mesh: Mesh, comparison: PhotoComparison, transform: np.ndarray) -> np.ndarray:
        """The similarity after Gauss-Newton steps on the outlines alone."""
        for _ in range(OUTLINE_STEPS):
            middle = middle_of(mesh, transform)
            rows, gaps, weights = comparison.outline_rows(transform, middle)
            if not weights.size:
                break
            transform = apply_steps(transform[None], solve_steps(rows, gaps, weights), middle)[0]
        return transform

    def _fit_in_small_steps(self, mesh: Mesh, comparison: PhotoComparison, best: PhotoFit) -> PhotoFit:
        """Pattern search (Hooke and Jeeves 1961) on outlines and colours together."""
        step = FIRST_STEP * np.array([1, 1, 1, self.size, self.size, self.size, 1])
        for _ in range(HALVINGS):
            before = best.error
            for axis in range(7):
                for sign in (1.0, -1.0):
                    change = np.zeros((1, 7))
                    change[0, axis] = sign * step[axis]
                    middle = middle_of(mesh, best.photos_from_mesh)
                    tried = comparison.measure(apply_steps(best.photos_from_mesh[None], change, middle)[0])
                    if tried.error < best.error:
                        best = tried
                        break
            if best.error > before - 1e-4:
                step = step / 2
        return best


def color_points(points: np.ndarray, normals: np.ndarray, photos: Sequence[ComparedPhoto]) -> np.ndarray:
    """(N, 3) colours from 0 to 1 of surface points: the mean of the photos that they face, those that see them best most."""
    total, weight = np.zeros((len(points), 3)), np.full(len(points), 1e-6)
    for photo in photos:
        rows, columns, _, inside = photo.camera.find_pixels(points)
        towards = photo.camera.centre_in_world - points
        cosine = np.einsum("ij,ij->i", normals, towards) / np.linalg.norm(towards, axis=1)
        strength = np.where(inside & (cosine > SHOWING_COSINE), np.clip(cosine, 0.0, 1.0) ** 2, 0.0)
        rows, columns = np.clip(rows, 0, photo.mask.shape[0] - 1), np.clip(columns, 0, photo.mask.shape[1] - 1)
        strength *= photo.mask[rows, columns]
        total += strength[:, None] * photo.color[rows, columns]
        weight += strength
    seen = weight > 1e-3
    colors = total / weight[:, None]
    colors[~seen] = colors[seen].mean(0) if seen.any() else 0.5
    return colors


def describe_fit(fit: PhotoFit) -> dict[str, float]:
    """The figures for the record."""
    return {"error": round(fit.error, 5), "overlap": round(fit.overlap, 5), "scale": float(f"{compute_scale(fit.photos_from_mesh):.6g}")}
