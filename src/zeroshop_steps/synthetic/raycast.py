"""Capture a virtual object with the embedded ray caster: the thesis's scenes su_l, su_h and se, and their exact truth.

su_l: on a nearly uniform grey surface. su_h: on a richly textured one. se: alone on black. Rings of ten views at 0 and +45
degrees (se: and -45).
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.synthetic import virtual
from zeroshop_steps.synthetic.renderer import Picture, Renderer
from zeroshop_steps.synthetic.rings import Subject
from zeroshop_steps.synthetic.scenes import Part
from zeroshop_steps.synthetic.shading import use_threads

CACHED = Cached(inputs=("model",), ignored=("threads",))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    virtual.add_scene_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    use_threads(args.threads)
    capture(args.model, args.scene, args.width, args.height, args.seed, args.out)


def capture(
    model: Path,
    scene: str,
    width_px: int,
    height_px: int,
    seed: int,
    out: Path,
    lay: virtual.Lay | None = None,
    facts: dict | None = None,
) -> None:
    """Render all views of one scene into the capture folder `out`; see `virtual.capture`."""

    def render(parts: list[Part], subject: Subject, cameras: Sequence[Camera]) -> Iterator[Picture]:
        renderer = Renderer(parts, subject, seed)
        return (renderer.render(camera) for camera in cameras)

    virtual.capture(render, model, scene, width_px, height_px, seed, out, lay, facts)
