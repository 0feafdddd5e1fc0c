"""Make the body that physics moves: the true model in convex parts, with its true mass.

CoACD (Wei et al. 2022) splits the model, since MuJoCo's contacts need convex parts. The centre of mass and the inertia are those of the
closed model, filled evenly. Masses are YCB's published ones (Calli et al. 2015), and plausible ones for the demo objects
(true_masses.csv).
"""

import argparse
import sys
from pathlib import Path

from zeroshop_steps.assets.convex_parts import split_convex
from zeroshop_steps.geometry.meshes.mass_properties import measure_solid
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import M_PER_MM
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import read_table
from zeroshop_steps.simulate.dynamics.physical_body import PhysicalBody, write_body

CACHED = Cached(inputs=("model",))
MASSES = Path(__file__).with_name("true_masses.csv")
MOST_PARTS, SEED = -1, 0  # as many parts as that takes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--model", type=Path, required=True, help="true model.ply, mm")
    parser.add_argument("--object", required=True, help="DATASET/OBJECT, by which its mass is known")
    parser.add_argument("--mass-kg", type=float, help="its mass, where none is known or another is wanted")
    parser.add_argument("--out", type=Path, required=True, help="body.npz to write")


def run(args: argparse.Namespace) -> None:
    """Write the physical body of one object."""
    mass_kg = find_mass_kg(args.object) if args.mass_kg is None else args.mass_kg
    if not 0.0 < mass_kg < 100.0:
        raise StepError(f"a mass of {mass_kg:g} kg is no mass of a thing that a hand lifts; expected kilograms above 0 and below 100")
    body = make_body(read_ply(args.model), mass_kg, str(args.model))
    write_body(args.out, body)
    print(f"{args.out}: {len(body.parts)} convex parts, {mass_kg:g} kg", file=sys.stderr)


def find_mass_kg(name: str) -> float:
    """The mass of DATASET/OBJECT. Raises StepError where none is known."""
    table = read_table(MASSES)
    found = table[table.dataset + "/" + table.object == name]
    if found.empty:
        example = ": {".join(name.split("/"))
        raise StepError(f"the mass of {name} is not known; give it in kilograms in the config: assets: {{masses_kg: {{{example}: 0.2}}}}}}")
    return float(found.mass_kg.iloc[0])


def make_body(mesh: Mesh, mass_kg: float, name: str) -> PhysicalBody:
    """The body of a closed model in millimetres; `name` is its file's, for messages. Raises StepError where it is open."""
    metric = Mesh(mesh.vertices * M_PER_MM, mesh.faces)
    solid = measure_solid(metric, name)
    # CoACD's default: up to which a part counts as convex.
    parts = tuple(part.vertices for part in split_convex(metric, 0.05, MOST_PARTS, SEED))
    return PhysicalBody(parts, mass_kg, solid.centre, solid.inertia_of(mass_kg))
