"""Make a rigid body of a finished mesh: mass, centre of mass and inertia of the closed mesh, and convex parts for collisions.

Everything is in metres and kilograms, in the frame of the mesh. The formats (urdf, mjcf, usd) refer to the files in this folder.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.assets.body_files import FRAME_TEXT, GENERATED_FRAME_TEXT, RECORD, write_part_obj, write_textured_obj
from zeroshop_steps.assets.convex_parts import measure_volume, split_convex
from zeroshop_steps.geometry.meshes.mass_properties import Solid, measure_solid
from zeroshop_steps.geometry.meshes.metric_mesh import add_mesh_arguments, read_metric_mesh
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory, write_json

PLAUSIBLE_KG = (0.0005, 100.0)
PLAUSIBLE_KG_M3 = (5.0, 23000.0)
SCALE_PITFALL = "Check the unit: masses are in kilograms, meshes in millimetres, height_m in metres"


@dataclass(frozen=True)
class Mass:
    """A body's mass.

    Attributes:
        mass_kg: the mass.
        source: `measured`, or `density` where it is the volume times a usual density.
        factor: the true mass lies, with 68 % probability, between `mass_kg` divided and multiplied by this; 1 where it was measured.
    """

    mass_kg: float
    source: str
    factor: float


def find_mass(volume_m3: float, mass_kg: float | None, density_kg_m3: float | None, density_factor: float, name: str) -> Mass:
    """The mass of a body.

    Args:
        volume_m3: that its closed mesh encloses.
        mass_kg: the measured mass, if there is one.
        density_kg_m3: the usual density of the enclosed volume otherwise, hollow or full.
        density_factor: its uncertainty, a factor above 1.
        name: of the mesh's file, for messages.

    Raises:
        StepError: neither is given, or the mass is not that of something that lies on a table.
    """
    if mass_kg is None and density_kg_m3 is None:
        raise StepError(
            f"{name} has no mass: give mass_kg (a column of objects.tsv, or assets.masses_kg in the config), or a usual density,"
            " assets.density_kg_m3"
        )
    if mass_kg is not None:
        found = Mass(mass_kg, "measured", 1.0)
    else:
        assert density_kg_m3 is not None
        found = Mass(volume_m3 * density_kg_m3, "density", density_factor)
        warn(
            f"the mass of {name} was not measured: {found.mass_kg:.3g} kg is its volume times {density_kg_m3:g} kg/m^3, right within a"
            f" factor of {density_factor:g}. Weigh it and give mass_kg"
        )
    if not PLAUSIBLE_KG[0] <= found.mass_kg <= PLAUSIBLE_KG[1]:
        raise StepError(
            f"{name} would weigh {found.mass_kg:.3g} kg; expected {PLAUSIBLE_KG[0]:g} to {PLAUSIBLE_KG[1]:g} kg. {SCALE_PITFALL}"
        )
    density = found.mass_kg / volume_m3
    if not PLAUSIBLE_KG_M3[0] <= density <= PLAUSIBLE_KG_M3[1]:
        raise StepError(
            f"{name} encloses {1e6 * volume_m3:.3g} cm^3, so {found.mass_kg:.3g} kg would be {density:.3g} kg/m^3; expected"
            f" {PLAUSIBLE_KG_M3[0]:g} to {PLAUSIBLE_KG_M3[1]:g}. {SCALE_PITFALL}"
        )
    return found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_mesh_arguments(parser)
    parser.add_argument("--name", help="the object's name in the files; the mesh's folder by default")
    parser.add_argument("--mass-kg", type=float, help="the measured mass")
    parser.add_argument("--density-kg-m3", type=float, help="a usual density, where the mass was not measured")
    parser.add_argument("--density-factor", type=float, default=2.2, help="the density is right within this factor (68 %%)")
    parser.add_argument("--friction", type=float, default=0.5, help="coefficient of sliding friction")
    parser.add_argument("--concavity", type=float, default=0.08, help="that convex parts may keep, as a share of the object's size")
    parser.add_argument("--most-parts", type=int, default=24, help="the largest number of convex parts")
    parser.add_argument("--seed", type=int, default=0, help="seed of the convex decomposition")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Make one body."""
    metric = read_metric_mesh(args.mesh, args.unknown_scale)
    solid = measure_solid(metric.mesh, str(args.mesh))
    mass = find_mass(solid.volume, args.mass_kg, args.density_kg_m3, args.density_factor, str(args.mesh))
    inertia = check_inertia(solid.inertia_of(mass.mass_kg), str(args.mesh))
    parts = split_convex(metric.mesh, args.concavity, args.most_parts, args.seed)
    with atomic_directory(args.out) as folder:
        write_textured_obj(folder, metric.mesh)
        names = [f"part_{number:02d}.obj" for number in range(len(parts))]
        for name, part in zip(names, parts, strict=True):
            write_part_obj(folder / name, part)
        facts = {
            "name": args.name or args.mesh.resolve().parent.name,
            "unit": "metre, kilogram",
            "frame": GENERATED_FRAME_TEXT if metric.generated else FRAME_TEXT,
            "scale": metric.scale,
            "scale_source": metric.scale_source,
            "generated": metric.generated,
            "mass_kg": mass.mass_kg,
            "mass_source": mass.source,
            "mass_factor": mass.factor,
            "volume_m3": solid.volume,
            "density_kg_m3": mass.mass_kg / solid.volume,
            "centre_of_mass_m": solid.centre.tolist(),
            "inertia_kg_m2": inertia.tolist(),
            "friction": args.friction,
            "parts": names,
            "parts_volume_share": _volume_share(parts, solid),
        }
        write_json(folder / RECORD, facts)
    size = " x ".join(f"{1000 * extent:.3g}" for extent in np.ptp(metric.mesh.vertices, axis=0))
    print(f"body: {size} mm, {mass.mass_kg:.3g} kg ({mass.source}), {len(parts)} convex parts", file=sys.stderr)


def check_inertia(inertia: np.ndarray, name: str) -> np.ndarray:
    """(3, 3) inertia, made exactly symmetric. Raises StepError where no body can have it: simulators refuse it or explode."""
    inertia = (inertia + inertia.T) / 2
    moments = np.linalg.eigvalsh(inertia)
    if not np.isfinite(moments).all() or moments[0] <= 0 or moments[0] + moments[1] < moments[2] * (1 - 1e-9):
        raise StepError(f"{name} has moments of inertia that no body has ({moments}); its surface crosses itself, make it again")
    return inertia


def _volume_share(parts: list, solid: Solid) -> float:
    """Volume of all parts together over that of the mesh; above 1 where they fill hollows or overlap."""
    return round(sum(map(measure_volume, parts)) / solid.volume, 4)
