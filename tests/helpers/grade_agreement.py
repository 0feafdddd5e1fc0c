"""Do the grades by photos and by truth agree on objects that no limit was fitted on?

Takes finished cells and copies of their meshes that are damaged, and fits limits on all objects but one, in turn, to grade that one.
As a command, on the folders of cells (their evidence, quality and photos are beside them):

    python tests/helpers/grade_agreement.py results/demo/*/su_h/truth/2dgs results/ycbv/*/su_h/truth/2dgs
"""

import argparse
import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from zeroshop_steps.evaluate.grade import measure_mesh
from zeroshop_steps.evaluate.grading import MEASURES, grade_by_worst
from zeroshop_steps.evaluate.quality import LARGEST
from zeroshop_steps.evaluate.surface_measures import measure_guessed_share
from zeroshop_steps.finish.closing.underside import drop_underside
from zeroshop_steps.geometry.alignment.surface_distance import measure_surface_error, sample_surface
from zeroshop_steps.geometry.cameras.pinhole import align_to_truth, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.transforms import transform_camera, transform_points
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.surface_fields import build_neighbour_matrix, smooth, weld
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, diameter_of
from zeroshop_steps.geometry.observation.support_classes import MEASURED, compute_area_shares
from zeroshop_steps.geometry.observation.vertex_support import classify_surface_support
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.surface.mvs.seeds import read_confirmed_points

DEFAULTS = {measure.name: (measure.good, measure.sparse) for measure in MEASURES}
TRIED = {
    "assumed_share": ((0.09, 0.12, 0.15, 0.2, 0.25, 0.3), (0.5,)),
    "guessed_share": ((0.01, 0.02, 0.03, 0.05), (0.2, 0.3, 0.5)),
    "roughness_deg": ((7.0, 8.0, 9.0, 10.0), (20.0, 25.0, 30.0)),
    "silhouette_agreement": ((0.96,), (0.9, 0.85, 0.8, 0.7, 0.6)),
    "displaced_share": ((0.02, 0.03, 0.05), (0.2, 0.3, 0.4)),
    "back_share": ((0.01, 0.02), (0.15, 0.25)),
}
"""Limits of good and of sparse that are fitted; the others stay. Masks are exact here, and those of real photos are not: so the limit of
good for silhouettes was set on these. And assumed surface that is too much for a plain cube may be right on other things."""
LEAST_GAIN = 2
"""A limit moves only where so many more grades agree: one grade is chance."""


@dataclass(frozen=True)
class Graded:
    """A mesh with its measures by photos and by truth."""

    cell: Path
    damage: str
    photos: dict[str, float]
    truth: dict[str, float]

    def agrees(self, limits: dict[str, tuple[float, float]]) -> bool:
        """Whether both grades are the same, the one by photos under these limits."""
        return grade_by_worst(self.photos, limits).grade == grade_by_worst(self.truth, DEFAULTS).grade


def rough(mesh: Mesh, deviation: float) -> Mesh:
    """Moved along the normals at random, by this deviation in diameters; neighbours move alike."""
    joined, _ = weld(mesh)
    noise = np.random.default_rng(1).normal(size=(len(joined.vertices), 1))
    noise = smooth(noise, build_neighbour_matrix(joined), 2)
    return Mesh(joined.vertices + deviation * diameter_of(joined) * noise / noise.std() * joined.vertex_normals, joined.faces)


def _find_side(mesh: Mesh) -> np.ndarray:
    """(3,) a point in the middle of a side."""
    points, faces = sample_surface(mesh, 2000, np.random.default_rng(3))
    low, size = mesh.vertices[:, 2].min(), np.ptp(mesh.vertices[:, 2])
    height = (points[:, 2] - low) / size
    upright = (np.abs(mesh.face_normals()[faces][:, 2]) < 0.5) & (height > 0.35) & (height < 0.8)
    return points[np.argmax(upright)]


def holed(mesh: Mesh, radius: float) -> Mesh:
    """Without the faces around a point of its side; `radius` in diameters."""
    far = np.linalg.norm(mesh.vertices[mesh.faces].mean(1) - _find_side(mesh), axis=1) > radius * diameter_of(mesh)
    used, index = np.unique(mesh.faces[far], return_inverse=True)
    return Mesh(mesh.vertices[used], index.reshape(-1, 3))


def dented(mesh: Mesh, depth: float) -> Mesh:
    """With a dent in its side, or a bump where `depth`, in diameters, is negative."""
    joined, _ = weld(mesh)
    distance = np.linalg.norm(joined.vertices - _find_side(joined), axis=1) / diameter_of(joined)
    moved = depth * diameter_of(joined) * np.exp(-((distance / 0.15) ** 2))
    return Mesh(joined.vertices - moved[:, None] * joined.vertex_normals, joined.faces)


def skirted(mesh: Mesh, width: float) -> Mesh:
    """With ground that sticks to its foot, `width` diameters wide."""
    joined, _ = weld(mesh)
    size, low = diameter_of(joined), joined.vertices[:, 2].min()
    foot = joined.vertices[joined.vertices[:, 2] < low + 0.1 * size][:, :2]
    inner = foot[ConvexHull(foot).vertices]
    away = inner - foot.mean(0)
    outer = inner + width * size * away / np.linalg.norm(away, axis=1, keepdims=True)
    count, top = len(inner), np.full(len(inner), low + 0.01 * size)
    ring = np.concatenate([np.c_[inner, top], np.c_[outer, top], np.c_[outer, np.full(count, low)]])
    here = np.arange(count)
    there = np.roll(here, -1)
    bands = [np.c_[a + here, b + here, b + there] for a, b in ((0, count), (count, 2 * count))]
    bands += [np.c_[a + here, b + there, a + there] for a, b in ((0, count), (count, 2 * count))]
    return Mesh(np.concatenate([joined.vertices, ring]), np.concatenate([joined.faces, np.concatenate(bands) + len(joined.vertices)]))


DAMAGES: dict[str, Callable[[Mesh], Mesh]] = {
    "as it is": lambda mesh: Mesh(mesh.vertices, mesh.faces),
    "rough, 0.2 %": lambda mesh: rough(mesh, 0.002),
    "rough, 0.4 %": lambda mesh: rough(mesh, 0.004),
    "hole, 12 %": lambda mesh: holed(mesh, 0.12),
    "dent, 5 %": lambda mesh: dented(mesh, 0.05),
    "bump, 4 %": lambda mesh: dented(mesh, -0.04),
    "ground, 8 %": lambda mesh: skirted(mesh, 0.08),
}


def grade_cell(cell: Path, damages: Sequence[str]) -> Iterator[Graded]:
    """The mesh of a finished cell of a rendered capture, damaged in these ways."""
    cameras, scene = cell.parent / "cameras", cell.parents[1]
    metadata = read_json(cell / "mesh.json")
    facts = metadata["frame_facts"]
    object_from_registration = np.array(facts["object_from_registration"])
    registered, _ = read_views(cameras)
    confirmed = transform_points(read_confirmed_points(cell.parent / "stereo/seeds.npz", registered), object_from_registration)
    views = [replace(view, camera=transform_camera(view.camera, object_from_registration)) for view in registered]
    model = scene.parent / "model"
    truth, diameter_mm = read_ply(model / "model.ply"), read_json(model / "model_info.json")["diameter"]
    true_cameras = read_sparse_model(scene / "capture/truth").cameras
    truth_from_registration = align_to_truth(pair_with_truth(tuple(view.camera for view in registered), true_cameras))
    truth_from_object = truth_from_registration @ np.linalg.inv(object_from_registration)
    whole = drop_underside(read_ply(cell / "mesh.ply"), metadata)
    for name in damages:
        mesh = DAMAGES[name](whole)
        supported = replace(mesh, quality=classify_surface_support(mesh, views, confirmed) / MEASURED)
        photos = measure_mesh(mesh, views, read_json(cameras / "registration.json")["images"], facts["bottom_z"])
        photos |= {"assumed_share": compute_area_shares(supported)["assumed"], "guessed_share": measure_guessed_share(supported, views)}
        aligned = Mesh(transform_points(mesh.vertices, truth_from_object), mesh.faces)
        error = measure_surface_error(aligned, truth, list(true_cameras), float(truth.vertices[:, 2].min()))
        figures = {
            "f_score_1_percent": error.f_score(0.01 * diameter_mm),
            "recall_1_percent": error.recall(0.01 * diameter_mm),
            "normal_error_deg": float(error.normal_deg.mean()),
            "largest_error_percent": 100.0 * error.largest_mm(LARGEST) / diameter_mm,
        }
        yield Graded(cell, name, photos, figures)


def fit_limits(cells: Sequence[Graded]) -> dict[str, tuple[float, float]]:
    """The limits under which most of these grades agree: one measure after the other, from the defaults, as long as more of them do."""
    limits, best, before = dict(DEFAULTS), _count_agreeing(cells, DEFAULTS), -1
    while best > before:
        before = best
        for name, tried in TRIED.items():
            # One limit moved before both: of pairs that agree equally often, the one that moves less is taken.
            for pair in sorted(itertools.product(*tried), key=lambda pair: sum(np.not_equal(pair, DEFAULTS[name]))):
                agreeing = _count_agreeing(cells, limits | {name: pair})
                if agreeing >= best + LEAST_GAIN:
                    limits[name], best = pair, agreeing
    return limits


def _count_agreeing(cells: Sequence[Graded], limits: dict[str, tuple[float, float]]) -> int:
    return sum(cell.agrees(limits) for cell in cells)


def main() -> None:
    """Print how often the grades agree, and where they do not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cells", type=Path, nargs="+", help="folders of finished cells of rendered captures")
    parser.add_argument("--damages", nargs="+", choices=DAMAGES, default=list(DAMAGES), help="what is done to their meshes")
    args = parser.parse_args()
    graded = [mesh for cell in args.cells for mesh in grade_cell(cell, args.damages)]
    fitted = {cell: fit_limits([mesh for mesh in graded if mesh.cell != cell]) for cell in args.cells}
    for mesh in graded:
        photos, truth = grade_by_worst(mesh.photos, DEFAULTS), grade_by_worst(mesh.truth, DEFAULTS)
        left_out = "" if mesh.agrees(fitted[mesh.cell]) else "; not by the others' limits"
        print(f"{mesh.cell} {mesh.damage}: photos {photos.grade}, truth {truth.grade}{left_out} {'; '.join(photos.reasons)}")
    usual, others = sum(mesh.agrees(DEFAULTS) for mesh in graded), sum(mesh.agrees(fitted[mesh.cell]) for mesh in graded)
    print(f"{usual} of {len(graded)} agree by the default limits, {others} by those fitted on the other objects")


if __name__ == "__main__":
    sys.exit(main())
