"""Let things fall onto a table with BlenderProc's physics (Bullet), until all are at rest: `... FOLDER`.

FOLDER has settle.json: for every thing the corners of its convex hull in mm and its first (4, 4) world_from_thing. Written is
settled.json: the last ones, and `moved_mm`, how far the quickest thing still moved in a further second.
"""

import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from zeroshop_steps.synthetic.blender.start import run

UNITS_A_MM = 0.01  # Bullet wants things of about one unit
TABLE_SIDE, TABLE_THICKNESS = 60.0, 2.0  # in units; 6 m, so that nothing rolls off
MARGIN = 0.005  # in units; Bullet keeps shapes this far apart
# High, so that things come to rest soon instead of rolling.
FRICTION, LINEAR_DAMPING, ANGULAR_DAMPING = 0.8, 0.3, 0.9
AT_LEAST_S, AT_MOST_S, EVERY_S = 3.0, 30.0, 1.0  # of simulated time, and how often it is looked whether all rest
REST_UNITS, REST_RAD = 0.002, 0.005  # moves and turns between two looks below which a thing rests
SUBSTEPS, SOLVER_STEPS = 20, 30  # of Bullet, for each frame


def settle(bproc: ModuleType, folder: Path) -> None:
    """Simulate and write what came to rest."""
    description = json.loads((folder / "settle.json").read_text())
    table = bproc.object.create_primitive("CUBE", size=1.0, scale=[TABLE_SIDE, TABLE_SIDE, TABLE_THICKNESS])
    table.set_location([0.0, 0.0, -TABLE_THICKNESS / 2])
    table.enable_rigidbody(active=False, collision_shape="BOX", collision_margin=MARGIN, friction=FRICTION)
    things = [_hull(bproc, f"thing {index:03d}", thing) for index, thing in enumerate(description["things"])]
    _simulate(bproc, AT_LEAST_S, AT_MOST_S)
    first = [np.array(thing.get_local2world_mat()) for thing in things]
    _simulate(bproc, 1.0, 1.5)
    last = [np.array(thing.get_local2world_mat()) for thing in things]
    moved_mm = max(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) for a, b in zip(first, last, strict=True)) / UNITS_A_MM
    for transform in last:
        transform[:3, 3] /= UNITS_A_MM
    partial = folder / ".settled.part"
    partial.write_text(json.dumps({"world_from_things": [transform.tolist() for transform in last], "moved_mm": moved_mm}))
    os.replace(partial, folder / "settled.json")


def _hull(bproc: ModuleType, name: str, thing: dict) -> Any:
    """A rigid body; its faces do not matter, its corners span the hull."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    corners = np.array(thing["hull_mm"]) * UNITS_A_MM
    mesh.from_pydata(corners.tolist(), [], thing["hull_faces"])
    body = bproc.object.create_from_blender_mesh(mesh, name)
    transform = np.array(thing["world_from_thing"])
    transform[:3, 3] *= UNITS_A_MM
    body.set_local2world_mat(transform)
    body.enable_rigidbody(
        active=True, collision_shape="CONVEX_HULL", collision_margin=MARGIN, friction=FRICTION,
        linear_damping=LINEAR_DAMPING, angular_damping=ANGULAR_DAMPING,
    )  # fmt: skip
    return body


def _simulate(bproc: ModuleType, at_least_s: float, at_most_s: float) -> None:
    bproc.object.simulate_physics_and_fix_final_poses(at_least_s, at_most_s, EVERY_S, REST_UNITS, REST_RAD, SUBSTEPS, SOLVER_STEPS)


if __name__ == "__main__":
    place = Path(sys.argv[1])
    run(lambda bproc: settle(bproc, place))
