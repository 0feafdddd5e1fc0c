"""Distances between a reconstructed and a true surface, in millimetres."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

SHARE_SAMPLES = 20_000  # of a surface whose shares are measured: one of 98 % is then exact to 0.1 %
SAMPLES = 100_000  # on each surface: the error of a mean is then 0.3 % of the distances' standard deviation


@dataclass(frozen=True)
class SurfaceError:
    """Sampled distances between two surfaces.

    Attributes:
        to_truth_mm: (N,) distance of samples of the reconstruction to the true surface.
        to_mesh_mm: (M,) distance of samples of the seen true surface to the reconstruction.
        normal_deg: (N,) angle between the reconstruction's normal and the one at the nearest true point.
        seen_share: share of the true surface that is seen.
    """

    to_truth_mm: np.ndarray
    to_mesh_mm: np.ndarray
    normal_deg: np.ndarray
    seen_share: float

    def precision(self, threshold_mm: float) -> float:
        """Share of the reconstruction that lies within a distance of the truth."""
        return float((self.to_truth_mm < threshold_mm).mean())

    def recall(self, threshold_mm: float) -> float:
        """Share of the seen true surface that lies within a distance of the reconstruction."""
        return float((self.to_mesh_mm < threshold_mm).mean())

    def f_score(self, threshold_mm: float) -> float:
        """Harmonic mean of precision and recall at a distance (Knapitsch et al. 2017, Tanks and Temples)."""
        precision, recall = self.precision(threshold_mm), self.recall(threshold_mm)
        return float(2 * precision * recall / max(precision + recall, 1e-12))

    def largest_mm(self, quantile: float) -> float:
        """The quantile of the distances from mesh to truth and of those from truth to mesh, whichever is larger."""
        return float(max(np.quantile(self.to_truth_mm, quantile), np.quantile(self.to_mesh_mm, quantile)))


def measure_surface_error(mesh: Mesh, truth: Mesh, cameras: list[Camera], support_z_mm: float | None) -> SurfaceError:
    """Compare `mesh` with `truth`, both in the true frame in mm.

    Args:
        mesh: the reconstruction, already aligned.
        truth: the true surface.
        cameras: the true cameras; surface that fewer than two of them see does not count.
        support_z_mm: height of the support plane, which hides what is below it; None without one.
    """
    rng = np.random.default_rng(0)
    points, faces, _ = sample_surface(mesh, SAMPLES, rng)
    distance, nearest = _nearest(truth, points)
    cosine = np.einsum("ij,ij->i", mesh.face_normals()[faces], truth.face_normals()[nearest])
    true_points, true_faces, _ = sample_surface(truth, SAMPLES, rng)
    seen = count_seeing_views(true_points, truth.face_normals()[true_faces], truth, cameras, support_z_mm) >= AGREEING_VIEWS
    to_mesh, _ = _nearest(mesh, true_points[seen])
    return SurfaceError(distance, to_mesh, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), float(seen.mean()))


def sample_surface(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(count, 3) random points, evenly distributed over the surface, (count,) their faces, and (count, 3) weights of these' corners."""
    corners, areas = mesh.vertices[mesh.faces], mesh.face_areas()
    faces = np.searchsorted(np.cumsum(areas), rng.uniform(0.0, areas.sum(), count)).clip(0, len(areas) - 1)
    root, second = np.sqrt(rng.uniform(size=(count, 1))), rng.uniform(size=(count, 1))
    weights = np.concatenate([1 - root, root * (1 - second), root * second], 1)
    return np.einsum("nk,nkd->nd", weights, corners[faces]), faces, weights


def count_seeing_views(
    points: np.ndarray, normals: np.ndarray, truth: Mesh, cameras: list[Camera], support_z_mm: float | None
) -> np.ndarray:
    """(N,) number of cameras that see each surface point: it is in the image, faces the camera, and nothing hides it."""
    scene = ray_caster((truth.vertices, truth.faces))
    count = np.zeros(len(points), int)
    for camera in cameras:
        if support_z_mm is not None and camera.centre_in_world[2] <= support_z_mm:
            continue  # from below, the support hides everything on it
        pixels, depth = camera.project(points)
        inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < (camera.width_px, camera.height_px)).all(1)
        directions = points - camera.centre_in_world
        chosen = np.flatnonzero(inside & (np.einsum("ij,ij->i", normals, directions) < 0))
        rays = np.concatenate([np.broadcast_to(camera.centre_in_world, (len(chosen), 3)), directions[chosen]], 1)
        hit = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
        # Rounding may put a sample just behind the first hit.
        count[chosen[hit > 1.0 - 1e-3]] += 1
    return count


def measure_distances(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """(N,) distances of (N, 3) points to the surface of `mesh`, in its unit."""
    return _nearest(mesh, points)[0]


def _nearest(mesh: Mesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    answer = ray_caster((mesh.vertices, mesh.faces)).compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
    return np.linalg.norm(answer["points"].numpy() - points, axis=1), answer["primitive_ids"].numpy().astype(np.int64)
