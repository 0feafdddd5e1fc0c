"""Damage a capture in planned steps, reconstruct from what is left, and grade: the grade has to fall.

The reconstruction is the usual fusion of depth maps into signed distances (Curless and Levoy 1996), with the exact depth in
place of a trained one; so all that is wrong with a mesh comes from the damage. `assumed_share` is left out: no stereo is
run here. As a command, on a finished cell:

    python tests/helpers/damage.py --capture results/demo/bowl/su_h/capture --model results/demo/bowl/model/model.ply
"""

import argparse
import functools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pymeshlab
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from helpers.solids import as_trimesh
from zeroshop_steps.evaluate.grade import make_grade_record, measure_mesh
from zeroshop_steps.evaluate.grading import MEASURES
from zeroshop_steps.geometry.alignment.surface_distance import measure_surface_error
from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.surface.meshing.raw_mesh import sort_mesh

LIMITS = {measure.name: (measure.good, measure.sparse) for measure in MEASURES}
CAMERA_NOISE_DEG = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)
VIEWS_KEPT = (20, 18, 15, 12, 8, 5)  # of twenty
MASK_ERRORS = (0.0, 0.05, 0.15, 0.3, 0.5, 0.8)  # radius of a bite out of each mask, as a share of the mask's size
CROPPED = (0.0, 0.02, 0.08, 0.2, 0.4, 0.7)  # share of the height cut off at the top
SMOOTHING_STEPS = (0, 10, 50, 200, 1000, 4000)


@dataclass(frozen=True)
class MemoryView(View):
    """A view with its pixels in memory."""

    pixels: np.ndarray
    silhouette: np.ndarray

    def image(self) -> np.ndarray:
        """(height, width, 3) uint8 sRGB."""
        return self.pixels

    def mask(self) -> np.ndarray:
        """(height, width) bool."""
        return self.silhouette


@dataclass(frozen=True)
class Case:
    """What there is to reconstruct from, and the truth, all in the true frame in millimetres.

    `taken` photos were taken; the views are those of them whose cameras are known.
    """

    truth: Mesh
    diameter_mm: float
    true_cameras: tuple[Camera, ...]
    views: tuple[MemoryView, ...]
    depths: tuple[np.ndarray, ...]
    taken: int

    @property
    def support_z_mm(self) -> float:
        """Height of the plane that the object stands on."""
        return float(self.truth.vertices[:, 2].min())


def read_case(capture: Path, model: Path) -> Case:
    """A virtual capture and its model."""
    truth, cameras = read_ply(model), read_sparse_model(capture / "truth").cameras
    renderer = MeshRenderer(truth)
    views = [
        MemoryView(camera, Path(), None, read_image(capture / "images" / camera.name), read_mask(capture / "masks" / camera.name))
        for camera in cameras
    ]
    depths = tuple(renderer.cast_rays(camera).depth for camera in cameras)
    return Case(truth, read_json(model.with_name("model_info.json"))["diameter"], cameras, tuple(views), depths, len(views))


def grade_of(case: Case, mesh: Mesh) -> dict:
    """The content of grade.json for a mesh in the true frame."""
    error = measure_surface_error(mesh, case.truth, list(case.true_cameras), case.support_z_mm)
    threshold_mm = 0.01 * case.diameter_mm
    truth = {
        "f_score_1_percent": error.f_score(threshold_mm),
        "recall_1_percent": float((error.to_mesh_mm < threshold_mm).mean()),
        "normal_error_deg": float(error.normal_deg.mean()),
    }
    return make_grade_record(measure_mesh(mesh, list(case.views), case.taken, case.support_z_mm), truth, LIMITS)


def fused(case: Case, voxels: int = 128) -> Mesh:
    """The surface on which the views' depth maps agree, seen by at least two; depth outside a mask is left out."""
    scale = 1.0 / case.diameter_mm
    voxel = np.ptp(case.truth.vertices, axis=0).max() * scale / voxels
    grid = o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1), (1)), voxel, 16, 20_000)
    for view, depth in zip(case.views, case.depths, strict=True):
        k, pose = view.camera.intrinsics.copy(), view.camera.camera_from_world.copy()
        k[:2, 2] -= 0.5  # Open3D puts pixel centres at integers
        pose[:3, 3] *= scale
        masked = np.where(view.mask(), depth * scale, 0.0).astype(np.float32)
        if not masked.any():
            continue
        image = o3d.t.geometry.Image(np.ascontiguousarray(masked[:, :, None]))
        k, pose = o3d.core.Tensor(k), o3d.core.Tensor(pose)
        blocks = grid.compute_unique_block_coordinates(image, k, pose, 1.0, 1e3, 5.0)
        grid.integrate(blocks, image, k, pose, 1.0, 1e3, 5.0)
    surface = grid.extract_triangle_mesh(weight_threshold=1.5)
    mesh = sort_mesh(surface.vertex.positions.numpy().astype(float), surface.triangle.indices.numpy().astype(np.int64))
    return Mesh(mesh.vertices / scale, mesh.faces)


def visual_hull(case: Case, resolution: int = 96) -> Mesh:
    """The smooth surface of what the masks leave: a bowl with its lid."""
    centre = (case.truth.vertices.min(0) + case.truth.vertices.max(0)) / 2
    half = 0.55 * float(np.ptp(case.truth.vertices, axis=0).max())
    cameras = []
    for view in case.views:
        camera_from_world = view.camera.camera_from_world.copy()
        camera_from_world[:3, 3] += camera_from_world[:3, :3] @ centre
        cameras.append(replace(view.camera, camera_from_world=camera_from_world))
    hull = VisualHull.carve(cameras, [view.mask() for view in case.views], half, resolution)
    volume = gaussian_filter(np.pad(hull.occupied, 2).astype(np.float32), 1.0)
    surface = o3d.t.geometry.TriangleMesh.create_isosurfaces(o3d.core.Tensor(np.ascontiguousarray(volume)), [0.5])
    index = surface.vertex.positions.numpy().astype(float)[:, ::-1] - 2.0  # Open3D's points are (z, y, x)
    mesh = Mesh(centre + (index + 0.5) / resolution * 2 * half - half, surface.triangle.indices.numpy().astype(np.int64))
    return mesh if as_trimesh(mesh).volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1].copy())


def noisy_cameras(case: Case, noise_deg: float) -> Case:
    """Every camera turned about its centre by an angle of this deviation around each axis."""
    rng = np.random.default_rng(0)
    views = []
    for view in case.views:
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(np.radians(noise_deg) * rng.normal(size=3)).as_matrix()
        views.append(replace(view, camera=replace(view.camera, camera_from_world=turn @ view.camera.camera_from_world)))
    return replace(case, views=tuple(views))


def fewer_views(case: Case, kept_of_twenty: int) -> Case:
    """Only the first views of each ring stay, so that a side is missing."""
    count = max(2, round(len(case.views) * kept_of_twenty / 20))
    half = len(case.views) // 2
    order = [index for pair in zip(range(half), range(half, 2 * half), strict=True) for index in pair]
    chosen = sorted(order[:count])
    return replace(case, views=tuple(case.views[k] for k in chosen), depths=tuple(case.depths[k] for k in chosen))


def fewer_photos(case: Case, kept_of_twenty: int) -> Case:
    """The same, as if the other photos had never been taken: every one that is there has its camera."""
    fewer = fewer_views(case, kept_of_twenty)
    return replace(fewer, taken=len(fewer.views))


def bitten_masks(case: Case, share: float) -> Case:
    """From each mask a disk is missing, somewhere on its border."""
    rng = np.random.default_rng(0)
    views = []
    for view in case.views:
        mask = view.mask().astype(np.uint8)
        border = np.argwhere(mask & ~cv2.erode(mask, np.ones((3, 3), np.uint8)))
        row, column = border[rng.integers(len(border))]
        if share > 0:
            cv2.circle(mask, (int(column), int(row)), round(share * np.sqrt(mask.sum())), 0, -1)
        views.append(replace(view, silhouette=mask.astype(bool)))
    return replace(case, views=tuple(views))


def cropped(mesh: Mesh, share: float) -> Mesh:
    """The mesh without the upper share of its height."""
    low, high = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
    kept = (mesh.vertices[mesh.faces][:, :, 2] <= high - share * (high - low)).all(1)
    used, index = np.unique(mesh.faces[kept], return_inverse=True)
    return Mesh(mesh.vertices[used], index.reshape(-1, 3))


def overly_smooth(mesh: Mesh, steps: int) -> Mesh:
    """Plain Laplacian smoothing, which rounds edges off and shrinks."""
    worker = pymeshlab.MeshSet(verbose=False)
    worker.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    if steps:
        worker.apply_coord_laplacian_smoothing(stepsmoothnum=steps, cotangentweight=False)
    return Mesh(np.array(worker.current_mesh().vertex_matrix()), mesh.faces)


def damages(case: Case) -> dict[str, tuple[tuple[float, ...], Callable[[float], tuple[Case, Mesh]]]]:
    """By name: the steps, and what makes the damaged case and its mesh of one step."""

    def of_case(change: Callable[[Case, float], Case]) -> Callable[[float], tuple[Case, Mesh]]:
        def make(step: float) -> tuple[Case, Mesh]:
            damaged = change(case, step)
            return damaged, fused(damaged)

        return make

    whole = functools.cache(lambda: fused(case))
    return {
        "camera noise, degrees": (CAMERA_NOISE_DEG, of_case(noisy_cameras)),
        "views kept of 20": (VIEWS_KEPT, of_case(fewer_views)),
        "photos taken of 20": (VIEWS_KEPT, of_case(fewer_photos)),
        "bite out of the masks": (MASK_ERRORS, of_case(bitten_masks)),
        "cropped from the top": (CROPPED, lambda step: (case, cropped(whole(), step))),
        "smoothing steps": (SMOOTHING_STEPS, lambda step: (case, overly_smooth(whole(), int(step)))),
    }


def graded_damages(case: Case, names: Sequence[str] | None = None, numbers: Sequence[int] = range(6)) -> Iterator[tuple[str, float, dict]]:
    """Name, step and content of grade.json for the numbered steps of the named damages (all of all by default)."""
    for name, (steps, make) in damages(case).items():
        for step in [steps[number] for number in numbers] if names is None or name in names else []:
            yield name, step, grade_of(*make(step))


def main() -> None:
    """Print a line for every step of every damage, and for the visual hull."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path, required=True, help="virtual capture")
    parser.add_argument("--model", type=Path, required=True, help="true model.ply")
    args = parser.parse_args()
    case = read_case(args.capture, args.model)
    print(f"{'damage':24}{'step':>7}  photos  truth   why not good")

    def show(name: str, step: float, content: dict) -> None:
        reasons = [reason.split(",")[0] for side in ("photos", "truth") for reason in content[side]["reasons"]]
        print(f"{name:24}{step:7g}  {content['photos']['grade']:7} {content['truth']['grade']:7} {'; '.join(reasons)}", flush=True)

    for name, step, content in graded_damages(case):
        show(name, step, content)
    show("visual hull", 0.0, grade_of(case, visual_hull(case)))


if __name__ == "__main__":
    sys.exit(main())
