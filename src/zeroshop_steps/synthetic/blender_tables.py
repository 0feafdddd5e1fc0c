"""Tables by BlenderProc: things that fell onto them, and path-traced pictures."""

import json
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import trimesh

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.synthetic.blender import settle as settle_script
from zeroshop_steps.synthetic.blender_environment import run_script
from zeroshop_steps.synthetic.blender_frames import make_scene_objects, render_frames
from zeroshop_steps.synthetic.blender_frames import read_frames as finished_pictures
from zeroshop_steps.synthetic.scenes.clutter import RigidBody, drop_bodies
from zeroshop_steps.synthetic.scenes.scene_meshes import make_object_mesh
from zeroshop_steps.synthetic.scenes.table_scene import TableScene

MOVED_MM = 0.5  # in the last part of the simulation; what moved farther is not at rest
BELOW_MM = 1.0  # what lies deeper in the table fell through it
ATTEMPTS = 5  # from other heights and turns


def settle_bodies(folder: Path, environment: Path, bodies: Sequence[RigidBody], rng: np.random.Generator) -> list[np.ndarray]:
    """(4, 4) table_from_model of bodies that fell onto the table and came to rest, in mm, z up, the table at 0.

    Args:
        folder: where the simulation is described and its outcome is kept.
        environment: record that `blender_environment` wrote.
        bodies: what falls.
        rng: of where from; another fall is tried where one does not end in rest.

    Raises:
        StepError: the environment is not usable, or nothing came to rest in several attempts.
    """
    for attempt in range(ATTEMPTS):
        outcome = _simulate_fall(folder / str(attempt), environment, bodies, drop_bodies(bodies, rng))
        transforms = [np.array(transform) for transform in outcome["world_from_things"]]
        pairs = zip(bodies, transforms, strict=True)
        lowest_mm = min(float((body.hull @ pose[2, :3] + pose[2, 3]).min()) for body, pose in pairs)
        if outcome["moved_mm"] <= MOVED_MM and lowest_mm >= -BELOW_MM:
            return transforms
    raise StepError(f"what fell onto the table did not come to rest in {ATTEMPTS} attempts; ask for fewer objects or for another --seed")


def render_table(
    folder: Path, environment: Path, title: str, scene: TableScene, cameras: Sequence[Camera], samples: int, threads: int
) -> Iterator[tuple[Camera, np.ndarray]]:
    """Each camera and its (height, width, 3) linear light; arguments as of `render_frames`."""
    things = make_scene_objects([make_object_mesh(scene.world), scene.table])
    render_frames(folder, environment, title, things, scene.lights, cameras, samples, scene.seed, threads)
    for camera, picture in zip(cameras, finished_pictures(folder, cameras), strict=True):
        yield camera, picture.linear


def _simulate_fall(folder: Path, environment: Path, bodies: Sequence[RigidBody], starts: Sequence[np.ndarray]) -> dict:
    """What settle.py says of this fall, now or in an earlier run."""
    things = []
    for body, start in zip(bodies, starts, strict=True):
        hull = trimesh.convex.convex_hull(body.hull)
        things.append({"hull_mm": hull.vertices.tolist(), "hull_faces": hull.faces.tolist(), "world_from_thing": start.tolist()})
    description, outcome = folder / "settle.json", folder / "settled.json"
    if not outcome.is_file() or not description.is_file() or json.loads(description.read_text()) != {"things": things}:
        shutil.rmtree(folder, ignore_errors=True)
        write_json(description, {"things": things})
        for _ in run_script(environment, settle_script, [str(folder)]):
            pass
    return read_json(outcome)
