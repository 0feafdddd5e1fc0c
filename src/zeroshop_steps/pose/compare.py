"""How well a pose explains an image: rendered depth, silhouette and colour against what was measured."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.bop.similarity_icp import likeness
from zeroshop_steps.cameras import Camera
from zeroshop_steps.finish.render import MeshRenderer, sample_texture
from zeroshop_steps.meshes import Mesh

RAYS = 1500
AGREE_MM = 10.0
PRINT_WEIGHT = 0.35


@dataclass(frozen=True)
class Patch:
    """The part of an image around a detection, thinned out to about `RAYS` pixels.

    Attributes:
        camera: of the thinned pixels; its world is the camera's frame.
        image: (h, w, 3) uint8.
        depth_mm: (h, w) measured.
        mask: (h, w) bool, the detection.
    """

    camera: Camera
    image: np.ndarray
    depth_mm: np.ndarray
    mask: np.ndarray


def patch_of(image: np.ndarray, depth_mm: np.ndarray, mask: np.ndarray, intrinsics: np.ndarray) -> Patch:
    """Cut out a detection with a margin of a third of its size; `intrinsics` are BOP's K."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    margin = max(len(rows), len(columns)) // 3 + 4
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    bottom, right = min(rows[-1] + margin, mask.shape[0] - 1) + 1, min(columns[-1] + margin, mask.shape[1] - 1) + 1
    step = max(1, round(np.sqrt((bottom - top) * (right - left) / RAYS)))
    cut = np.s_[top:bottom:step, left:right:step]
    thinned = intrinsics.copy()
    thinned[:2] /= step
    thinned[0, 2], thinned[1, 2] = (intrinsics[0, 2] - left) / step + 0.5, (intrinsics[1, 2] - top) / step + 0.5
    height, width = mask[cut].shape
    return Patch(Camera("", width, height, thinned, np.eye(4)), image[cut], depth_mm[cut], mask[cut])


class Comparison:
    """Compares poses of one model with images."""

    def __init__(self, mesh: Mesh) -> None:
        self._renderer = MeshRenderer(mesh)
        self._mesh = mesh

    def score(self, pose: np.ndarray, patch: Patch) -> float:
        """0..1, higher is better: the share of the object's pixels whose depth agrees, and how alike print and photo are."""
        camera = Camera("", patch.camera.width_px, patch.camera.height_px, patch.camera.intrinsics, pose)
        hits = self._renderer.hits(camera)
        known, there = patch.depth_mm > 0, hits.mask
        hidden = there & known & ~patch.mask & (patch.depth_mm < hits.depth - AGREE_MM)
        agree = there & patch.mask & (~known | (np.abs(hits.depth - patch.depth_mm) < AGREE_MM))
        shape = agree.sum() / max((patch.mask | (there & ~hidden)).sum(), 1)
        chosen = agree[hits.mask]
        if self._mesh.texture is None or self._mesh.uv is None or chosen.sum() < 20:
            return float(shape * (1 - PRINT_WEIGHT))
        corners = self._mesh.uv[self._mesh.faces[hits.face[hits.mask][chosen]]]
        second, third = hits.barycentric[hits.mask][chosen].T[:, :, None]
        uv = corners[:, 0] * (1.0 - second - third) + corners[:, 1] * second + corners[:, 2] * third
        print_alike = likeness(sample_texture(self._mesh.texture, uv).astype(float), patch.image[agree].astype(float))
        return float(shape * (1 - PRINT_WEIGHT + PRINT_WEIGHT * max(print_alike, 0.0)))
