"""Render the frames of a described scene with BlenderProc: `... FOLDER THREADS`.

FOLDER has scene.json and what it names. Every frame becomes `frame_NNNNNN.npz`, written beside and renamed, so that it is
whole or absent; those that are there stay. It holds `linear` (height, width, 3), linear light, and `depth_mm` and `thing` (height,
width) at the pixel's centre: 0 for nothing, else the thing's number + 1.
"""

import json
import os
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from zeroshop_steps.synthetic.blender.start import run, tell
from zeroshop_steps.synthetic.blender.world import DIFFUSE_BOUNCES, GLOSSY_BOUNCES, M_A_MM, MAX_BOUNCES, build


def render(bproc: ModuleType, folder: Path, threads: int) -> None:
    """Render the frames that are missing."""
    scene = json.loads((folder / "scene.json").read_text())
    build(bproc, folder, scene)
    bproc.renderer.set_cpu_threads(threads)
    bproc.renderer.set_output_format("OPEN_EXR", color_depth=32)
    bproc.renderer.enable_depth_output(activate_antialiasing=False)
    bproc.renderer.enable_segmentation_output(map_by="instance", default_values={})
    files = _output_files()
    for frame in range(len(scene["world_from_cameras"])):
        target = folder / f"frame_{frame:06d}.npz"
        if target.exists():
            continue
        depth_m, thing = _geometry(bproc, frame, files)
        color = _color(bproc, frame, files, scene["samples"], scene["seed"])
        partial = folder / f".frame_{frame:06d}.part"
        with partial.open("wb") as file:
            np.savez(
                file,
                linear=color.astype(np.float16),
                # Where a ray hits nothing, the depth is huge.
                depth_mm=np.where(depth_m < 1e6, depth_m / M_A_MM, 0.0).astype(np.float32),
                thing=thing.astype(np.uint8),
            )
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, target)
        tell("frame", frame)


def _output_files() -> list:
    """The nodes that write depth and thing numbers, told to write them in full precision."""
    import bpy

    nodes = [node for node in bpy.context.scene.node_tree.nodes if node.bl_idname == "CompositorNodeOutputFile"]
    for node in nodes:
        node.format.color_depth = "32"
    return nodes


def _show(frame: int, files: list, with_geometry: bool, samples: int, filter_px: float, seed: int) -> None:
    """Set what Blender renders next."""
    import bpy

    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = frame, frame + 1
    scene.cycles.samples, scene.cycles.filter_width, scene.cycles.seed = samples, filter_px, seed
    for node in files:
        node.mute = not with_geometry


def _geometry(bproc: ModuleType, frame: int, files: list) -> tuple[np.ndarray, np.ndarray]:
    """(height, width) depth in m and thing number along the ray through each pixel's centre."""
    bproc.renderer.set_denoiser(None)
    bproc.renderer.set_light_bounces(0, 0, 0, 0)
    # A filter this narrow samples the pixel's centre.
    _show(frame, files, True, 1, 0.01, 0)
    found = bproc.renderer.render(load_keys={"depth", "segmap"}, verbose=True)
    return found["depth"][0], found["instance_segmaps"][0]


def _color(bproc: ModuleType, frame: int, files: list, samples: int, seed: int) -> np.ndarray:
    """(height, width, 3) denoised linear light."""
    bproc.renderer.set_denoiser("INTEL")
    bproc.renderer.set_light_bounces(DIFFUSE_BOUNCES, GLOSSY_BOUNCES, 0, MAX_BOUNCES)
    _show(frame, files, False, samples, 1.5, (1000003 * seed + frame) % 2**31)
    return bproc.renderer.render(load_keys={"colors"}, verbose=True)["colors"][0]


if __name__ == "__main__":
    place, count = Path(sys.argv[1]), int(sys.argv[2])
    run(lambda bproc: render(bproc, place, count))
