"""The capture of a virtual object, whichever renderer takes its pictures: the same cameras, files and sensor noise for all.

Beside images and masks, `depth/` and `truth/` keep what is exactly true, `held_out/` two more views.
"""

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, write_cameras
from zeroshop_steps.geometry.imaging.images import write_depth_mm, write_image, write_mask
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import OBJECT_SIZES_M, Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.synthetic.rendering.lighting import LIGHT_STRENGTHS
from zeroshop_steps.synthetic.rendering.renderer import RenderedView, expose
from zeroshop_steps.synthetic.scenes.camera_rings import (
    DISTANCE_IN_SIZES,
    USUAL_RINGS,
    ObjectBounds,
    Rings,
    place_capture_cameras,
    place_held_out_cameras,
)
from zeroshop_steps.synthetic.scenes.scene_meshes import SCENES, SceneMesh, make_object_mesh, make_surface_mesh

Lay = Callable[[Mesh, ObjectBounds], Callable[[np.ndarray], None]]  # given the object, what paints the surface's texture
Render = Callable[
    [list[SceneMesh], ObjectBounds, Sequence[Camera]], Iterable[RenderedView]
]  # the pictures of these cameras, in their order


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all renderers share."""
    parser.add_argument("--model", type=Path, required=True, help="textured PLY in mm, upright, z up")
    parser.add_argument("--scene", choices=SCENES, required=True)
    add_image_arguments(parser)
    parser.add_argument("--views-per-ring", type=int, default=USUAL_RINGS.views, help="azimuths of a ring (default %(default)s)")
    parser.add_argument("--elevations-deg", type=float, nargs="+", help="of the rings (default 0 45, se: 0 45 -45)")
    height_help = "least height of a camera above the surface, in largest dimensions of the object (default %(default)s)"
    parser.add_argument("--least-height-sizes", type=float, default=USUAL_RINGS.least_height_sizes, help=height_help)
    light_help = "towards +x, -x, +y, -y, +z and -z, relative to each other"
    parser.add_argument("--light-strengths", type=float, nargs=6, default=LIGHT_STRENGTHS, help=light_help)
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def read_rings(args: argparse.Namespace) -> Rings:
    """The rings that the arguments ask for."""
    return Rings(args.views_per_ring, tuple(args.elevations_deg) if args.elevations_deg else None, args.least_height_sizes)


def add_image_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all rendered captures share."""
    parser.add_argument("--width", type=int, default=1000, help="image width in px (default 1000)")
    parser.add_argument("--height", type=int, default=750, help="image height in px (default 750)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the surface and of the sensor noise (default 0)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default all)")


def render_capture(
    render: Render,
    model: Path,
    scene: str,
    width_px: int,
    height_px: int,
    seed: int,
    out: Path,
    lay: Lay | None = None,
    facts: dict | None = None,
    rings: Rings = USUAL_RINGS,
) -> None:
    """Render all views of one scene into the capture folder `out`, whole or not at all.

    Args:
        render: the renderer.
        model: textured PLY in mm, upright.
        scene: su_l, su_h or se.
        width_px, height_px: of the images.
        seed: of the surface and of the sensor noise.
        out: folder to write.
        lay: what lies on the surface.
        facts: for capture.json, over what stands there.
        rings: where the cameras stand.

    Raises:
        StepError: the model is missing, damaged, untextured or not in mm; the image size or the seed is out of range.
    """
    start_s = time.monotonic()
    mesh, bounds, info = read_object(model, width_px, height_px, seed)
    paint = lay(mesh, bounds) if lay else None
    try:
        parts = [part for part in (make_object_mesh(mesh), make_surface_mesh(scene, bounds, seed, paint)) if part is not None]
    except StepError as error:
        raise StepError(f"{model}: {error}") from None
    views = place_capture_cameras(bounds, scene, width_px, height_px, rings)
    held_out = place_held_out_cameras(bounds, scene, width_px, height_px, rings)
    with atomic_directory(out) as folder:
        jobs = [(camera, folder, index) for index, camera in enumerate(views)]
        jobs += [(camera, folder / "held_out", len(views) + index) for index, camera in enumerate(held_out)]
        pictures = render(parts, bounds, [camera for camera, _, _ in jobs])
        for (camera, place, number), picture in zip(track(jobs, f"render {scene}", len(jobs)), pictures, strict=True):
            rng = np.random.default_rng([seed, number, SCENES.index(scene)])
            write_view(picture, camera.name, place, rng, scene, with_depth=place == folder)
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
                "distance_mm": round(bounds.distance_mm, 3),
                "distance_in_largest_dimensions": DISTANCE_IN_SIZES,
                "ring_elevations_deg": list(rings.of_scene(scene)),
                "front_azimuth_deg": bounds.front_azimuth_deg,
                "support_z_mm": None if scene == "se" else round(bounds.bottom_mm, 4),
                **(facts or {}),
                "seconds": round(time.monotonic() - start_s, 2),
            },
        )


def read_object(model: Path, width_px: int, height_px: int, seed: int) -> tuple[Mesh, ObjectBounds, dict]:
    """The model, what the cameras look at, and its model_info.json; refuses what `render_capture` refuses."""
    if not (64 <= width_px <= 8000 and 48 <= height_px <= 6000):
        raise StepError(f"image size {width_px} x {height_px} px is out of range; give --width 64..8000 and --height 48..6000")
    if seed < 0:
        raise StepError(f"seed {seed} is negative; give --seed 0 or more")
    mesh = with_texture(read_ply(model))
    info_path = Path(model).with_name("model_info.json")
    info = read_json(info_path) if info_path.exists() else {}
    bounds = measure_bounds(mesh, model, float(info.get("front_azimuth_deg", 0.0)))
    return mesh, bounds, info


def measure_bounds(mesh: Mesh, model: Path, front_azimuth_deg: float) -> ObjectBounds:
    """What the cameras look at; refuses a mesh whose size cannot be millimetres of a hand-held object."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    largest_mm = float((high - low).max())
    if largest_mm == 0.0:
        raise StepError(f"{model} has no size: all of its vertices are one point; export the model again")
    if not OBJECT_SIZES_M[0] <= largest_mm / 1000 <= OBJECT_SIZES_M[1]:
        expected = "{:g}..{:g} mm".format(*(1000 * size_m for size_m in OBJECT_SIZES_M))
        raise StepError(f"{model}: its largest dimension is {largest_mm:g}; expected {expected}. Convert the model to millimetres.")
    return ObjectBounds((low + high) / 2, largest_mm, float(low[2]), front_azimuth_deg)


def write_view(picture: RenderedView, name: str, folder: Path, rng: np.random.Generator, scene: str, with_depth: bool) -> None:
    """Photograph one view, and write its image and mask and, where wanted, its depth."""
    image = expose(picture.linear, rng)
    if scene == "se":
        image[~picture.mask] = 0
    write_image(folder / "images" / name, image)
    write_mask(folder / "masks" / name, picture.mask)
    if with_depth:
        write_depth_mm(folder / "depth" / name, picture.depth_mm)
