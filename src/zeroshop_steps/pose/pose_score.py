"""Score poses by how well they explain an image: rendered depth, silhouette and colour are compared with the measured ones."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.alignment.similarity_icp import correlate_colors
from zeroshop_steps.geometry.alignment.surface_points import sample_surface_points
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import sample_texture
from zeroshop_steps.pose.nearest_surface import FEW_SAMPLES
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
COARSE_RAYS, RAYS, FINE_RAYS = 500, 1500, 6000  # per patch, for a hundred poses, for the best ones, and for the final choice
AGREE_MM = 10.0  # of depth: a pixel agrees if it is off by less, and the more the less it is off
PRINT_WEIGHT = 0.35  # of the likeness of colours in the score, on a model with strong print; the rest is shape
PLAIN_CONTRAST = 10.0  # of 255: standard deviation of a model's colours at which print has half of that weight; shading varies as much
LEAST_PRINTED = 20  # pixels that must agree for a correlation of colours; it is chance with fewer, and the likeness is then 0
UNSEEN_LIKENESS = 0.7  # assumed for faces whose print no photo saw: between that of right and of wrong poses
HOLLOW_SHARE = 0.5  # weight of measured depth behind an assumed surface: there may be a hollow, or the pose may be wrong
COARSEST_PX = 64  # shorter side below which the texture is not halved any more; print is gone by then
PATCH_MARGIN, LEAST_MARGIN_PX = 3, 4  # a patch reaches beyond the mask by a third of its longer side and so many pixels


@dataclass(frozen=True)
class ImagePatch:
    """Every n-th pixel of the image around a detection.

    Attributes:
        rays: (N, 3) directions of unit depth through the pixels, camera frame.
        colors: (N, 3) float, 0..255, means over the n x n pixels that each stands for.
        depth_mm: (N,) measured, 0 where there is none.
        mask: (N,) bool, the detection.
        pixel_share: side of those n x n pixels at unit depth.
    """

    rays: np.ndarray
    colors: np.ndarray
    depth_mm: np.ndarray
    mask: np.ndarray
    pixel_share: float


def cut_patch(image: np.ndarray, depth_mm: np.ndarray, mask: np.ndarray, intrinsics: np.ndarray, rays: int = RAYS) -> ImagePatch:
    """Cut out a detection with a margin, thinned out to about `rays` pixels; `intrinsics` is BOP's K."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    margin = max(len(rows), len(columns)) // PATCH_MARGIN + LEAST_MARGIN_PX
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    bottom, right = min(rows[-1] + margin, mask.shape[0] - 1) + 1, min(columns[-1] + margin, mask.shape[1] - 1) + 1
    step = max(1, round(np.sqrt((bottom - top) * (right - left) / rays)))
    cut = np.s_[top:bottom:step, left:right:step]
    smooth = cv2.blur(image[top:bottom, left:right], (step, step))[::step, ::step]
    pixels = np.stack(np.broadcast_arrays(np.arange(left, right, step), np.arange(top, bottom, step)[:, None], 1.0), -1)
    directions = pixels.reshape(-1, 3) @ np.linalg.inv(intrinsics).T
    return ImagePatch(directions, smooth.reshape(-1, 3).astype(float), depth_mm[cut].ravel(), mask[cut].ravel(), step / intrinsics[0, 0])


class PoseScorer:
    """Scores poses of one model.

    Behind an assumed surface there may be a hollow, so measured depth between it and the next surface counts half. Print of surface
    that no photo saw counts neither for a pose nor against it.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._seen, self._assumed = mesh.seen_faces(), mesh.assumed_faces()
        self._scene = ray_caster((mesh.vertices, mesh.faces))
        self._behind = ray_caster((mesh.vertices, mesh.faces[~self._assumed])) if self._assumed.any() else None
        samples = sample_surface_points(mesh, FEW_SAMPLES, np.random.default_rng(0))
        self._printed = samples.colors is not None
        if samples.colors is not None:
            contrast = 255.0 * float(np.sqrt(samples.colors.var(0).mean()))
            self._print_weight = PRINT_WEIGHT * contrast**2 / (contrast**2 + PLAIN_CONTRAST**2)
        if mesh.is_textured:
            self._textures = _make_mip_levels(mesh.texture_image)
            self._texels_per_mm = _measure_texels_per_mm(mesh)

    def score(self, poses: np.ndarray, patch: ImagePatch) -> np.ndarray:
        """(P,) scores, 0..1, higher is better, of (P, 4, 4) camera_from_model in mm.

        The share of the object's pixels whose depth agrees, weighted by how well, times the likeness of print and photo.
        """
        turns = poses[:, :3, :3]
        rays = np.empty((len(poses), len(patch.rays), 6), np.float32)
        rays[..., :3] = -np.einsum("pij,pi->pj", turns, poses[:, :3, 3])[:, None]
        rays[..., 3:] = patch.rays @ turns
        hits = self._scene.cast_rays(o3d.core.Tensor(rays))
        depth = hits["t_hit"].numpy()
        there, known = np.isfinite(depth), patch.depth_mm > 0
        off = np.where(there & known, np.abs(depth - patch.depth_mm), 0.0) / AGREE_MM
        faces = hits["primitive_ids"].numpy()
        hollow = self._find_hollow(rays, faces, there & known & patch.mask, depth, patch) if self._behind is not None else False
        agree = there & patch.mask & (off < 1.0)
        hidden = there & known & ~patch.mask & (patch.depth_mm < depth - AGREE_MM)
        explained = np.maximum(agree * (1.0 - off**2), HOLLOW_SHARE * hollow)
        shape = explained.sum(1) / np.maximum((patch.mask | (there & ~hidden)).sum(1), 1)
        if not self._printed:
            return shape
        alike = self._compare_colors(faces, hits["primitive_uvs"].numpy(), agree, depth, patch)
        return shape * (1.0 - self._print_weight + self._print_weight * alike)

    def _find_hollow(self, rays: np.ndarray, faces: np.ndarray, known: np.ndarray, depth: np.ndarray, patch: ImagePatch) -> np.ndarray:
        """(P, N) bool: the model's surface is assumed, and the measured depth lies between it and the next measured surface."""
        candidates = known.copy()
        candidates[known] = self._assumed[faces[known]]
        candidates &= patch.depth_mm > depth - AGREE_MM
        assert self._behind is not None
        next_depth = self._behind.cast_rays(o3d.core.Tensor(rays[candidates]))["t_hit"].numpy()
        measured = np.broadcast_to(patch.depth_mm, candidates.shape)[candidates]
        candidates[candidates] = np.isfinite(next_depth) & (measured < next_depth + AGREE_MM)
        return candidates

    def _compare_colors(self, faces: np.ndarray, shares: np.ndarray, agree: np.ndarray, depth: np.ndarray, patch: ImagePatch) -> np.ndarray:
        """(P,) likeness, 0..1: correlation of the colours where depth agrees, at the resolution of the pixels."""
        all_that_agree = agree.sum(1)
        agree = agree.copy()
        agree[agree] = self._seen[faces[agree]]
        unseen = 1.0 - agree.sum(1) / np.maximum(all_that_agree, 1)
        return (1.0 - unseen) * self._compare_seen_colors(faces, shares, agree, depth, patch) + unseen * UNSEEN_LIKENESS

    def _compare_seen_colors(
        self, faces: np.ndarray, shares: np.ndarray, agree: np.ndarray, depth: np.ndarray, patch: ImagePatch
    ) -> np.ndarray:
        """(P,) 0..1: correlation of the colours at the pixels that `agree`."""
        alike = np.zeros(len(agree))
        if not agree.any():
            return alike
        colors = self._look_up_colors(faces[agree], shares[agree], float(np.median(depth[agree])) * patch.pixel_share)
        ends = np.cumsum(agree.sum(1))
        for index, (start, end) in enumerate(zip(ends - agree.sum(1), ends, strict=True)):
            if end - start >= LEAST_PRINTED:
                alike[index] = max(correlate_colors(colors[start:end].astype(float), patch.colors[agree[index]]), 0.0)
        return alike

    def _look_up_colors(self, faces: np.ndarray, shares: np.ndarray, pixel_mm: float) -> np.ndarray:
        """(N, 3) 0..255 in the texture, at the resolution of pixels of this size, or else of the vertices, at points on `faces`."""
        second, third = shares.T[:, :, None]

        def interpolate(values: np.ndarray) -> np.ndarray:
            corners = values[self._mesh.faces[faces]]
            return corners[:, 0] * (1.0 - second - third) + corners[:, 1] * second + corners[:, 2] * third

        if not self._mesh.is_textured:
            assert self._mesh.colors is not None
            return interpolate(self._mesh.colors)
        level = int(np.clip(round(np.log2(max(self._texels_per_mm * pixel_mm, 1.0))), 0, len(self._textures) - 1))
        return sample_texture(self._textures[level], interpolate(self._mesh.texture_coordinates))


def _make_mip_levels(texture: np.ndarray) -> list[np.ndarray]:
    """The texture and coarser copies, each half as wide as the one before."""
    textures = [texture]
    while min(textures[-1].shape[:2]) >= 2 * COARSEST_PX:
        textures.append(cv2.resize(textures[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    return textures


def _measure_texels_per_mm(mesh: Mesh) -> float:
    """Mean number of texels along a millimetre of the surface."""
    corners, uv = mesh.vertices[mesh.faces], mesh.texture_coordinates[mesh.faces] * mesh.texture_image.shape[1::-1]
    area_mm2 = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return float(np.sqrt(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum() / max(area_mm2, 1e-9)))
