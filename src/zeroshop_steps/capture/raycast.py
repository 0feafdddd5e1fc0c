"""Capture a virtual object with the embedded ray caster: the thesis's scenes su_l, su_h and se, and their exact truth.

su_l: on a nearly uniform grey surface. su_h: on a richly textured one. se: alone on black. Rings of ten views at 0 and +45
degrees (se: and -45). Beside images and masks, `depth/` and `truth/` keep what is exactly true, `held_out/` two more views.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from zeroshop_steps.cache import Cached
from zeroshop_steps.cameras import Camera, write_cameras
from zeroshop_steps.capture.renderer import Renderer, expose
from zeroshop_steps.capture.rings import DISTANCE_IN_SIZES, ELEVATIONS_DEG, Subject, capture_cameras, held_out_cameras
from zeroshop_steps.capture.scenes import SCENES, object_part, surface_part
from zeroshop_steps.capture.shading import use_threads
from zeroshop_steps.errors import StepError
from zeroshop_steps.files import read_json, write_json, written_whole_dir
from zeroshop_steps.images import write_depth_mm, write_image, write_mask
from zeroshop_steps.meshes import Mesh, read_ply
from zeroshop_steps.progress import track

Lay = Callable[[Mesh, Subject], Callable[[np.ndarray], None]]  # given the object, what paints the surface's texture

CACHED = Cached(inputs=("model",), ignored=("threads",))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--model", type=Path, required=True, help="textured PLY in mm, upright, z up")
    parser.add_argument("--scene", choices=SCENES, required=True)
    add_image_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def add_image_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all rendered captures share."""
    parser.add_argument("--width", type=int, default=1000, help="image width in px (default 1000)")
    parser.add_argument("--height", type=int, default=750, help="image height in px (default 750)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the surface and of the sensor noise (default 0)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default all)")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    use_threads(args.threads)
    capture(args.model, args.scene, args.width, args.height, args.seed, args.out)


def capture(
    model: Path, scene: str, width_px: int, height_px: int, seed: int, out: Path, lay: Lay | None = None, facts: dict | None = None
) -> None:
    """Render all views of one scene into the capture folder `out`, whole or not at all.

    Args:
        model: textured PLY in mm, upright.
        scene: su_l, su_h or se.
        width_px, height_px: of the images.
        seed: of the surface and of the sensor noise.
        out: folder to write.
        lay: what lies on the surface.
        facts: for capture.json, over what stands there.

    Raises:
        StepError: the model is missing, damaged, untextured or not in mm; the image size or the seed is out of range.
    """
    start_s = time.monotonic()
    mesh, subject, info = read_subject(model, width_px, height_px, seed)
    paint = lay(mesh, subject) if lay else None
    try:
        parts = [part for part in (object_part(mesh), surface_part(scene, subject, seed, paint)) if part is not None]
    except StepError as error:
        raise StepError(f"{model}: {error}") from None
    renderer = Renderer(parts, subject, seed)
    views = capture_cameras(subject, scene, width_px, height_px)
    held_out = held_out_cameras(subject, scene, width_px, height_px)
    with written_whole_dir(out) as folder:
        jobs = [(camera, folder, index) for index, camera in enumerate(views)]
        jobs += [(camera, folder / "held_out", len(views) + index) for index, camera in enumerate(held_out)]
        for camera, place, number in track(jobs, f"render {scene}", len(jobs)):
            write_view(
                renderer, camera, place, np.random.default_rng([seed, number, SCENES.index(scene)]), scene, with_depth=place == folder
            )
        write_cameras(folder / "truth", views)
        write_cameras(folder / "held_out" / "truth", held_out)
        size_mm = np.ptp(mesh.vertices, axis=0)
        write_json(
            folder / "capture.json",
            {
                "scene": scene,
                "virtual": True,
                "seed": seed,
                "width_px": width_px,
                "height_px": height_px,
                "images": len(views),
                "held_out_images": len(held_out),
                "object": info.get("name"),
                "known_height_m": round(float(size_mm[2]) / 1000.0, 6),
                "distance_mm": round(subject.distance_mm, 3),
                "distance_in_largest_dimensions": DISTANCE_IN_SIZES,
                "ring_elevations_deg": list(ELEVATIONS_DEG[scene]),
                "front_azimuth_deg": subject.front_azimuth_deg,
                "support_z_mm": None if scene == "se" else round(subject.bottom_mm, 4),
                **(facts or {}),
                "seconds": round(time.monotonic() - start_s, 2),
            },
        )


def read_subject(model: Path, width_px: int, height_px: int, seed: int) -> tuple[Mesh, Subject, dict]:
    """The model, what the cameras look at, and its model_info.json; refuses what `capture` refuses."""
    if not (64 <= width_px <= 8000 and 48 <= height_px <= 6000):
        raise StepError(f"image size {width_px} x {height_px} px is out of range; give --width 64..8000 and --height 48..6000")
    if seed < 0:
        raise StepError(f"seed {seed} is negative; give --seed 0 or more")
    mesh = read_ply(model)
    info_path = Path(model).with_name("model_info.json")
    info = read_json(info_path) if info_path.exists() else {}
    subject = subject_of(mesh, model, float(info.get("front_azimuth_deg", 0.0)))
    return mesh, subject, info


def subject_of(mesh: Mesh, model: Path, front_azimuth_deg: float) -> Subject:
    """What the cameras look at; refuses a mesh whose size cannot be millimetres of a hand-held object."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    largest_mm = float((high - low).max())
    if not 5.0 <= largest_mm <= 3000.0:
        raise StepError(f"{model}: its largest dimension is {largest_mm:g}; expected 5..3000 mm. Convert the model to millimetres.")
    return Subject((low + high) / 2, largest_mm, float(low[2]), front_azimuth_deg)


def write_view(renderer: Renderer, camera: Camera, folder: Path, rng: np.random.Generator, scene: str, with_depth: bool) -> None:
    """Render and photograph one view, and write its image and mask and, where wanted, its depth."""
    picture = renderer.render(camera)
    image = expose(picture.linear, rng)
    if scene == "se":
        image[~picture.mask] = 0
    write_image(folder / "images" / camera.name, image)
    write_mask(folder / "masks" / camera.name, picture.mask)
    if with_depth:
        write_depth_mm(folder / "depth" / camera.name, picture.depth_mm)
