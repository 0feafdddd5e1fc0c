"""Capture a virtual object with BlenderProc (Blender's path tracer Cycles): the scenes, cameras and files of `raycast`.

Materials are dielectrics in the colours of the model's texture, lit by the same six area lights and sky. Frames that were
finished before an interruption are taken up by the same command.
"""

import argparse
import json
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import trimesh

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.synthetic import virtual_capture
from zeroshop_steps.synthetic.blender import settle as settle_script
from zeroshop_steps.synthetic.blender_environment import run_script
from zeroshop_steps.synthetic.blender_frames import make_scene_objects, read_frames, render_frames
from zeroshop_steps.synthetic.blender_frames import read_frames as finished_pictures
from zeroshop_steps.synthetic.rendering.lighting import LIGHT_STRENGTHS, place_lights
from zeroshop_steps.synthetic.rendering.renderer import RenderedView
from zeroshop_steps.synthetic.scenes.camera_rings import USUAL_RINGS, ObjectBounds, Rings
from zeroshop_steps.synthetic.scenes.clutter import RigidBody, drop_bodies
from zeroshop_steps.synthetic.scenes.scene_meshes import SceneMesh, make_object_mesh
from zeroshop_steps.synthetic.scenes.table_scene import TableBackend, TableScene

MOVED_MM = 0.5  # in the last part of the simulation; what moved farther is not at rest
BELOW_MM = 1.0  # what lies deeper in the table fell through it
ATTEMPTS = 5  # from other heights and turns
CACHED = Cached(inputs=("model",), ignored=("threads", "environment"))

METHOD = {"rank": 1, "runtime_min": 240, "environment": "resources/envs/blenderproc.json", "samples": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    virtual_capture.add_scene_arguments(parser)
    add_renderer_arguments(parser)


def add_renderer_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of everything that BlenderProc renders."""
    parser.add_argument("--samples", type=int, default=16, help="light paths a pixel, denoised afterwards (default: %(default)s)")
    parser.add_argument("--environment", type=Path, help="record of BlenderProc's environment, which blender_environment writes")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    options = (args.scene, args.width, args.height, args.seed, args.samples, args.environment, args.threads, args.out)
    capture(args.model, *options, virtual_capture.read_rings(args), args.light_strengths)


def capture(
    model: Path,
    scene: str,
    width_px: int,
    height_px: int,
    seed: int,
    samples: int,
    environment: Path,
    threads: int,
    out: Path,
    rings: Rings = USUAL_RINGS,
    light_strengths: Sequence[float] = LIGHT_STRENGTHS,
) -> None:
    """Render all views of one scene into the capture folder `out`; see `virtual_capture.render_capture`.

    Args:
        samples: light paths a pixel.
        environment: record that `blender_environment` wrote.
        threads: of the renderer, 0 for all.
        rings: where the cameras stand.
        light_strengths: as for `lighting.place_lights`.

    Raises:
        StepError: as `virtual_capture.render_capture`; or BlenderProc cannot start, failed or was killed.
    """
    check_options(samples, environment)
    frames = frames_folder(out)

    def render(parts: list[SceneMesh], bounds: ObjectBounds, cameras: Sequence[Camera]) -> Iterator[RenderedView]:
        lights = place_lights(bounds, len(parts) > 1, light_strengths)
        title = f"render {scene} with BlenderProc"
        render_frames(frames, environment, title, make_scene_objects(parts), lights, cameras, samples, seed, threads)
        return read_frames(frames, cameras)

    facts = {"renderer": "blenderproc", "samples": samples}
    virtual_capture.render_capture(render, model, scene, width_px, height_px, seed, out, facts=facts, rings=rings)
    shutil.rmtree(frames, ignore_errors=True)


def make_table_backend(args: argparse.Namespace) -> TableBackend:
    """Renders cluttered tables whose things fell there; frames that were finished before an interruption are kept."""
    check_options(args.samples, args.environment)
    frames = frames_folder(args.out)

    def settle(scene_id: int, bodies: Sequence[RigidBody], rng: np.random.Generator) -> list[np.ndarray]:
        return settle_bodies(frames / f"settled_{scene_id:06d}", args.environment, bodies, rng)

    def render(scene_id: int, scene: TableScene, cameras: Iterable[Camera]) -> Iterator[tuple[Camera, np.ndarray]]:
        folder, title = frames / f"{scene_id:06d}", f"table {scene_id} of {args.scenes}"
        return render_table(folder, args.environment, title, scene, list(cameras), args.samples, args.threads)

    return TableBackend(settle, render, lambda: shutil.rmtree(frames, ignore_errors=True))


def frames_folder(out: Path) -> Path:
    """Where frames wait until all are there."""
    return Path(out).with_name(f".{Path(out).name}.frames")


def check_options(samples: int, environment: Path | None) -> None:
    """Refuse what BlenderProc cannot work with."""
    if not 1 <= samples <= 65536:
        raise StepError(f"{samples} samples a pixel are out of range; give --samples 1..65536")
    if environment is None:
        raise StepError("BlenderProc has an environment of its own; make it with --method blender_environment and give its record")


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
