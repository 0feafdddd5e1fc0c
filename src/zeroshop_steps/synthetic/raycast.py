"""Capture a virtual object with the embedded ray caster: the thesis's scenes su_l, su_h and se, and their exact truth.

su_l: on a nearly uniform grey surface. su_h: on a richly textured one. se: alone on black. Rings of ten views at 0 and +45
degrees (se: and -45).
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.synthetic import virtual_capture
from zeroshop_steps.synthetic.rendering.lighting import LIGHT_STRENGTHS, place_lights
from zeroshop_steps.synthetic.rendering.renderer import RenderedView, SceneRenderer
from zeroshop_steps.synthetic.rendering.shading import use_threads
from zeroshop_steps.synthetic.scenes.camera_rings import USUAL_RINGS, ObjectBounds, Rings
from zeroshop_steps.synthetic.scenes.clutter import place_bodies
from zeroshop_steps.synthetic.scenes.scene_meshes import SceneMesh
from zeroshop_steps.synthetic.scenes.table_scene import TableBackend, render_raycast

CACHED = Cached(inputs=("model",), ignored=("threads",))

METHOD = {"rank": 0, "runtime_min": 10}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    virtual_capture.add_scene_arguments(parser)


def add_renderer_arguments(parser: argparse.ArgumentParser) -> None:
    """This renderer has no options of its own."""


def make_table_backend(args: argparse.Namespace) -> TableBackend:
    """Renders cluttered tables whose things stand apart."""
    return TableBackend(lambda _, bodies, rng: place_bodies(bodies, rng), lambda _, scene, cameras: render_raycast(scene, cameras))


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    use_threads(args.threads)
    rings = virtual_capture.read_rings(args)
    capture(args.model, args.scene, args.width, args.height, args.seed, args.out, rings=rings, light_strengths=args.light_strengths)


def capture(
    model: Path,
    scene: str,
    width_px: int,
    height_px: int,
    seed: int,
    out: Path,
    lay: virtual_capture.Lay | None = None,
    facts: dict | None = None,
    rings: Rings = USUAL_RINGS,
    light_strengths: Sequence[float] = LIGHT_STRENGTHS,
) -> None:
    """Render all views of one scene into the capture folder `out`; see `virtual_capture.render_capture` and `lighting.place_lights`."""

    def render(parts: list[SceneMesh], bounds: ObjectBounds, cameras: Sequence[Camera]) -> Iterator[RenderedView]:
        renderer = SceneRenderer(parts, bounds, seed, place_lights(bounds, len(parts) > 1, light_strengths))
        return (renderer.render(camera) for camera in cameras)

    virtual_capture.render_capture(
        render, model, scene, width_px, height_px, seed, out, lay, {"renderer": "raycast", **(facts or {})}, rings
    )
