"""Align a reconstructed mesh with its true model by a similarity, found from shape and print alone.

A search from all sides is followed by iterated closest points. Only the measured surface is used: upside down, a closed underside
looks like a plain top, and a lid like the floor of its hollow. Where shape decides nothing, as for the rotation of a can about its
axis, print does. If the model is symmetric, the symmetry that turns the mesh least is chosen. Writes the transform and how far apart
the two surfaces then are.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.symmetry import list_symmetry_transforms
from zeroshop_steps.geometry.alignment.similarity_icp import SimilarityFit, SimilarityRefiner
from zeroshop_steps.geometry.alignment.similarity_search import search_similarities
from zeroshop_steps.geometry.alignment.surface_distance import measure_distances
from zeroshop_steps.geometry.alignment.surface_points import sample_surface_points
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_points
from zeroshop_steps.geometry.meshes.mesh_files import read_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.support_classes import with_surface_support
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import read_json, write_json

SOURCE_SAMPLES, TARGET_SAMPLES = 8000, 40000  # of the mesh and of the model; the model's must lie closer than what is to be measured
# Median distances in diameters beyond which a mesh is refused; the second is larger, since parts of the model may be missing in the mesh.
WORST_MESH_DIAMETERS, WORST_TRUTH_DIAMETERS = 0.02, 0.1
METRES = (500.0, 2000.0)  # scales that say that the mesh is in metres
PLAUSIBLE_SCALE = (0.8, 1.25)  # scales that need no notice; a mesh with a measured height is within a few per cent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="reconstructed mesh.ply")
    parser.add_argument("--evidence", type=Path, help="evidence.npz of the mesh; without it, all of the mesh is used")
    parser.add_argument("--model", type=Path, required=True, help="true model.ply with model_info.json beside it, which has its symmetries")
    parser.add_argument("--seed", type=int, default=0, help="seed of the samples on the surfaces (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="aligned.json")


def run(args: argparse.Namespace) -> None:
    """Align one mesh."""
    start_s = time.monotonic()
    mesh, truth = read_mesh(args.mesh), read_mesh(args.model)
    if args.evidence:
        mesh = with_surface_support(mesh, args.evidence)
        mesh = replace(mesh, faces=mesh.faces[mesh.measured_faces()]).without_loose_vertices()
        if len(mesh.faces) == 0:
            raise StepError(f"{args.evidence} says that nothing of {args.mesh} was measured; it cannot be aligned")
    info = read_json(args.model.with_name("model_info.json"))
    fit = align(mesh, truth, list_symmetry_transforms(info), args.seed)
    figures = measure_residuals(mesh, truth, fit, info["diameter"], args.seed)
    apart_mm, missing_mm = figures["mesh_to_truth_median_mm"], figures["truth_to_mesh_median_mm"]
    if apart_mm > WORST_MESH_DIAMETERS * info["diameter"] or missing_mm > WORST_TRUTH_DIAMETERS * info["diameter"]:
        raise StepError(
            f"{args.mesh} cannot be aligned with {args.model}: at best half of it lies {apart_mm:.1f} mm and more from it, and half"
            f" of the model {missing_mm:.1f} mm and more from the mesh; the mesh is not this object, or too little of it"
        )
    notice = describe_scale(figures["scale"])
    if notice:
        warn(f"{args.mesh}: {notice}")
    content = {"truth_from_mesh": np.round(fit.transform, 7).tolist(), **figures, "notice": notice, "model_info": info}
    write_json(args.out, content | {"seconds": round(time.monotonic() - start_s, 2)})
    print(f"aligned: {figures['mesh_to_truth_mm']:.2f} mm from the truth, scale {figures['scale']:.4f}", file=sys.stderr)


def align(mesh: Mesh, truth: Mesh, symmetries: np.ndarray, seed: int = 0) -> SimilarityFit:
    """Find the similarity truth_from_mesh.

    Args:
        mesh: the measured part of the reconstruction.
        truth: the true model, mm.
        symmetries: (S, 4, 4) of the true model.
        seed: of the samples.
    """
    rng = np.random.default_rng(seed)
    source, target = sample_surface_points(mesh, SOURCE_SAMPLES, rng), sample_surface_points(truth, TARGET_SAMPLES, rng)
    best = SimilarityRefiner(source, target).choose_best(search_similarities(source, target))[0]
    alike = symmetries @ best.transform
    turned_least = np.argmax(np.round(np.trace(alike[:, :3, :3], axis1=1, axis2=2), 9))
    return SimilarityFit(alike[turned_least], best.distance, best.likeness)


def measure_residuals(mesh: Mesh, truth: Mesh, fit: SimilarityFit, diameter_mm: float, seed: int) -> dict:
    """Distances between the aligned mesh and the true model, and the scale of truth_from_mesh: the figures of aligned.json."""
    aligned = Mesh(transform_points(mesh.vertices, fit.transform), mesh.faces)
    rng = np.random.default_rng(seed)
    there = measure_distances(truth, sample_surface_points(aligned, SOURCE_SAMPLES, rng).points)
    back = measure_distances(aligned, sample_surface_points(truth, SOURCE_SAMPLES, rng).points)
    figures = {
        "scale": compute_scale(fit.transform),
        "mesh_to_truth_mm": float(there.mean()),
        "mesh_to_truth_median_mm": float(np.median(there)),
        "mesh_to_truth_95_percent_mm": float(np.percentile(there, 95)),
        "truth_to_mesh_median_mm": float(np.median(back)),
        "mesh_to_truth_diameters": float(there.mean() / diameter_mm),
        "print_likeness": fit.likeness,
    }
    return {name: round(value, 5) for name, value in figures.items()}


def describe_scale(scale: float) -> str | None:
    """What a scale far from 1 means; None if it is close to 1."""
    if METRES[0] <= scale <= METRES[1]:
        return f"it had to grow {scale:.0f} times: it is in metres, where millimetres are expected"
    if not PLAUSIBLE_SCALE[0] <= scale <= PLAUSIBLE_SCALE[1]:
        return f"it had to be scaled by {scale:.4g}: its unit is not the millimetre"
    return None
