"""Frames rendered by BlenderProc: the scene is described in a folder, another environment's Python renders it there, frame by frame.

A folder that was left by an interrupted run of the same scene keeps its finished frames.
"""

import hashlib
import json
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.mesh_repair import find_triangles
from zeroshop_steps.runtime.files import atomic_write, write_json
from zeroshop_steps.runtime.progress import ProgressReport
from zeroshop_steps.synthetic.blender import render_frames as render_script
from zeroshop_steps.synthetic.blender import world
from zeroshop_steps.synthetic.blender_environment import run_script
from zeroshop_steps.synthetic.rendering import lighting
from zeroshop_steps.synthetic.rendering.renderer import BACKGROUND, RenderedView
from zeroshop_steps.synthetic.scenes.scene_meshes import SceneMesh

OBJECT_ROUGHNESS, SURFACE_ROUGHNESS = 0.4, 0.8  # of Blender's material, 0 a mirror, 1 chalk
BACKGROUND_GREYS = (0.85 * BACKGROUND, 0.3 * BACKGROUND)  # the ray caster's: level, and what it gains towards the zenith
NEAREST_IN_DISTANCES = 0.05  # from where on a camera sees, as a share of the smallest distance to the object's middle
CODE = (render_script, world)  # frames of another version of these do not go with new ones


@dataclass(frozen=True)
class SceneObject:
    """A textured surface in the scene.

    Attributes:
        part: its mesh and texture.
        world_from_thing: (4, 4) in mm.
        roughness: of its material, 0 a mirror, 1 matt.
    """

    part: SceneMesh
    world_from_thing: np.ndarray
    roughness: float


def make_scene_objects(parts: Sequence[SceneMesh]) -> list[SceneObject]:
    """The object and, if there is one, the surface of a capture."""
    return [SceneObject(part, np.eye(4), roughness) for part, roughness in zip(parts, (OBJECT_ROUGHNESS, SURFACE_ROUGHNESS), strict=False)]


def render_frames(
    folder: Path, environment: Path, title: str, things: Sequence[SceneObject], lights: lighting.Lights, cameras: Sequence[Camera],
    samples: int, seed: int, threads: int,
) -> None:  # fmt: skip
    """Render what is missing of the frames of a scene into `folder`.

    Args:
        folder: where the scene is described and its frames lie; emptied where another scene lies there.
        environment: record that `blender_environment` wrote.
        title: of the progress.
        things: what stands there; the first is the object that masks mean.
        lights: six area lights and the sky.
        cameras: all of the same size and intrinsics.
        samples: paths a pixel.
        seed: of the paths.
        threads: of the renderer, 0 for all.

    Raises:
        StepError: the environment is not usable, or the renderer failed or was killed.
    """
    _write_description(folder, things, lights, cameras, samples, seed)
    missing = [frame for frame in range(len(cameras)) if _read_frame(folder, frame) is None]
    if not missing:
        return
    there = len(cameras) - len(missing)
    known = f" ({there} of {len(cameras)} were there)" if there else ""
    with ProgressReport(f"{title}{known}", len(missing), line_every_s=0.0) as report:
        for kind, _ in run_script(environment, render_script, [str(folder), str(threads)]):
            if kind == "frame":
                report.advance()


def read_frames(folder: Path, cameras: Sequence[Camera]) -> Iterator[RenderedView]:
    """The rendered frames of these cameras, in their order."""
    for index in range(len(cameras)):
        frame = _read_frame(folder, index)
        assert frame is not None, f"frame {index} of {folder} was rendered a moment ago"
        yield RenderedView(frame["linear"].astype(np.float32), frame["thing"] == 1, frame["depth_mm"])


def _write_description(
    folder: Path, things: Sequence[SceneObject], lights: lighting.Lights, cameras: Sequence[Camera], samples: int, seed: int
) -> None:
    """Write scene.json and its meshes and textures, unless they are there already."""
    meshes = [_mesh_arrays(thing.part) for thing in things]
    textures = [_texture(thing.part) for thing in things]
    world_from_cameras = [np.linalg.inv(camera.camera_from_world) for camera in cameras]
    nearest_mm = min(float(np.linalg.norm(pose[:3, 3] - _middle(things[0]))) for pose in world_from_cameras) * NEAREST_IN_DISTANCES
    scene = {
        "width_px": cameras[0].width_px,
        "height_px": cameras[0].height_px,
        "intrinsics": cameras[0].intrinsics.tolist(),
        "world_from_cameras": [pose.tolist() for pose in world_from_cameras],
        "nearest_mm": nearest_mm,
        "samples": samples,
        "seed": seed,
        "sky": float(lights.sky),
        "background": BACKGROUND_GREYS if len(things) > 1 else (0.0, 0.0),
        "light_half_side_mm": float(lights.half_side_mm),
        "lights": [
            {"centre_mm": centre.tolist(), "axes": axes.tolist(), "radiance": float(radiance)}
            for centre, axes, radiance in zip(lights.centres, lights.axes, lights.radiances, strict=True)
        ],
        "things": [
            {
                "world_from_thing": thing.world_from_thing.tolist(),
                "wrap": bool(thing.part.pyramid.wrap),
                "roughness": thing.roughness,
                "content": hashlib.sha256(b"".join(array.tobytes() for array in [*mesh.values(), texture])).hexdigest(),
            }
            for thing, mesh, texture in zip(things, meshes, textures, strict=True)
        ],
        "code": [hashlib.sha256(Path(str(script.__file__)).read_bytes()).hexdigest() for script in CODE],
    }
    description = folder / "scene.json"
    if description.is_file() and description.read_text() == json.dumps(scene, indent=2) + "\n":
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for index, (mesh, texture) in enumerate(zip(meshes, textures, strict=True)):
        with atomic_write(folder / f"thing_{index}.npz") as temporary:
            np.savez(temporary, **mesh)
        write_image(folder / f"thing_{index}.png", texture)
    write_json(description, scene)


def _mesh_arrays(part: SceneMesh) -> dict[str, Any]:
    """Without faces that name a vertex twice, which Blender cannot hold."""
    faces = part.faces
    whole = find_triangles(faces)
    return {
        "vertices_mm": part.vertices,
        "faces": faces[whole],
        "corner_normals": part.corner_normals[whole],
        "corner_uv": part.corner_uv[whole],
    }


def _texture(part: SceneMesh) -> np.ndarray:
    """(height, width, 3) uint8: the finest level, with which the ray caster works, too."""
    _, width, height = part.pyramid.levels[0]
    return part.pyramid.texels[: width * height].reshape(height, width, 3)


def _middle(thing: SceneObject) -> np.ndarray:
    middle = (thing.part.vertices.min(0) + thing.part.vertices.max(0)) / 2
    return thing.world_from_thing[:3, :3] @ middle + thing.world_from_thing[:3, 3]


def _read_frame(folder: Path, index: int) -> dict[str, np.ndarray] | None:
    """A finished frame; None where there is none. A damaged one is removed."""
    path = folder / f"frame_{index:06d}.npz"
    try:
        with np.load(path) as arrays:
            return {name: arrays[name] for name in ("linear", "depth_mm", "thing")}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        path.unlink(missing_ok=True)
        return None
