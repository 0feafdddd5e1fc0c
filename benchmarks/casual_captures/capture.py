"""Photograph a model as people do at home: a few photos from one side or around, off-centre, among other things, with the exact truth.

The capture has images/ alone, as a phone gives them. `truth/` is for judging: the cameras (a COLMAP model in mm), masks/ of what is
seen of the object in each photo, and truth.json. `held_out/` has more photos with masks and cameras, for judging a mesh.
"""

import argparse
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from casual_captures.scene import DIFFICULTIES, FULL_ROUND_DEG, CasualRenderer, Style, choose_style, lay_scene
from zeroshop_steps.geometry.cameras.pinhole import Camera, write_cameras
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.geometry.imaging.images import write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, atomic_write, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.synthetic import virtual_capture
from zeroshop_steps.synthetic.rendering.renderer import expose
from zeroshop_steps.synthetic.rendering.shading import use_threads
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds

LONG_SIDE_PX = 720
FOCAL_IN_LONG_SIDES = (0.72, 0.86)  # of phones: 26 to 31 mm on a full frame
LEAST_DISTANCE_MM = 200.0  # nearer a phone does not focus
FRAMED_SHARE, FRAMED_DEVIATION = (0.42, 0.68), 0.14  # of the image's short side that the object's diagonal fills, and its change
ELEVATIONS_DEG, ELEVATION_DEVIATION_DEG, LEAST_ELEVATION_DEG = (20.0, 48.0), 6.0, 12.0
ROLL_DEVIATION_DEG, STEP_DEVIATION = 3.0, 0.2  # of the camera, and of the steps around, in steps
AIM_DEVIATION = 0.06  # what a photo's middle misses the object by, in short sides
CUT_SHARE, CUT_OFF = 0.4, (0.12, 0.42)  # where photos cut the object off: how many do, and how much of its extent
BRIGHT_LEVELS, HARD_BRIGHT_LEVELS = (0.62, 0.82), (0.28, 1.25)  # linear light of the 90th percentile of a photo
TINT_DEVIATION, HARD_TINT_DEVIATION = 0.02, 0.06  # standard deviations of the logarithm, of each colour
BLUR_PX, HARD_BLUR_PX = (0.35, 0.6), (0.4, 1.3)
NOISE, HARD_NOISE = 0.004, 0.018  # of linear light, beside that of a good sensor
HELD_OUT = 3  # photos for judging alone


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--model", type=Path, required=True, help="textured PLY in mm, upright, z up")
    parser.add_argument("--difficulty", type=int, choices=DIFFICULTIES, required=True, help="how many things make masks hard: 0, 1 or 3")
    parser.add_argument("--seed", type=int, default=0, help="seed of all that is random (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write: images/ and truth/")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    use_threads(args.threads)
    render_casual_capture(args.model, args.difficulty, args.seed, args.out)


def render_casual_capture(model: Path, difficulty: int, seed: int, out: Path, long_side_px: int = LONG_SIDE_PX) -> None:
    """Write the photos and the truth into the capture folder `out`.

    Raises:
        StepError: as `virtual_capture.render_capture` does.
    """
    mesh, bounds, info = virtual_capture.read_object(model, long_side_px, long_side_px * 3 // 4, seed)
    rng = np.random.default_rng([seed, difficulty, *np.frombuffer(str(info.get("name", "")).encode(), np.uint8)])
    style = choose_style(difficulty, rng)
    bounds = ObjectBounds(bounds.centre_mm, bounds.largest_mm, bounds.bottom_mm, bounds.front_azimuth_deg + rng.uniform(-40, 40))
    cameras = place_cameras(mesh, bounds, style, long_side_px, rng)
    view = CasualRenderer(lay_scene(mesh, bounds, style, cameras, rng))
    hard = "exposure" in style.hard
    with atomic_directory(out) as folder:
        for camera in track(cameras, "photos", len(cameras)):
            image = photograph(view.render(camera).linear, hard, rng)
            _write_photo(folder / "images" / camera.name, image)
            write_mask(folder / "truth" / "masks" / f"{Path(camera.name).stem}.png", view.render_mask(camera))
        write_cameras(folder / "truth", cameras)
        _hold_out(view, mesh, bounds, style, long_side_px, [seed, difficulty, HELD_OUT], folder / "held_out")
        height_mm = float(np.ptp(mesh.vertices[:, 2]))
        facts = {"object": info.get("name"), "difficulty": difficulty, "seed": seed, "height_m": round(height_mm / 1000, 6)}
        write_json(folder / "truth" / "truth.json", facts | asdict(style))
        write_json(folder / "capture.json", {"virtual": True, "images": len(cameras)})


def _hold_out(
    view: CasualRenderer, mesh: Mesh, bounds: ObjectBounds, style: Style, long_side_px: int, seeds: list[int], folder: Path
) -> None:
    """Write photos that belong to no capture, from places between, into `folder`: images/, masks/ and truth/."""
    rng = np.random.default_rng(seeds)
    cameras = place_cameras(mesh, bounds, replace(style, hard=(), photos=HELD_OUT), long_side_px, rng)
    for camera in cameras:
        _write_photo(folder / "images" / camera.name, photograph(view.render(camera).linear, False, rng))
        write_mask(folder / "masks" / f"{Path(camera.name).stem}.png", view.render_mask(camera))
    write_cameras(folder / "truth", cameras)


def place_cameras(mesh: Mesh, bounds: ObjectBounds, style: Style, long_side_px: int, rng: np.random.Generator) -> list[Camera]:
    """Where a hand holds the camera, photo by photo: along the style's arc, whose middle is the object's front, never quite steady."""
    short_px = long_side_px * 3 // 4
    width_px, height_px = (short_px, long_side_px) if style.portrait else (long_side_px, short_px)
    focal_px = rng.uniform(*FOCAL_IN_LONG_SIDES) * long_side_px
    diagonal_mm = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    framed_mm = diagonal_mm * focal_px / (rng.uniform(*FRAMED_SHARE) * short_px)
    steps = style.photos if style.arc_deg == FULL_ROUND_DEG else style.photos - 1
    base_deg = rng.uniform(*ELEVATIONS_DEG)
    cameras = []
    for number in range(style.photos):
        share = (number + STEP_DEVIATION * rng.normal()) / steps - 0.5
        azimuth = np.radians(bounds.front_azimuth_deg + style.arc_deg * share)
        elevation = np.radians(max(base_deg + ELEVATION_DEVIATION_DEG * rng.normal(), LEAST_ELEVATION_DEG))
        distance_mm = max(framed_mm * np.exp(FRAMED_DEVIATION * rng.normal()), LEAST_DISTANCE_MM)
        shift = AIM_DEVIATION * rng.normal(size=2) * short_px
        pose = look_at(bounds.centre_mm + distance_mm * direction_at(azimuth, elevation), bounds.centre_mm)
        if "cut_off" in style.hard and rng.uniform() < CUT_SHARE:
            aimed = Camera("", width_px, height_px, make_intrinsics(focal_px, width_px, height_px), pose)
            axis = int(rng.integers(2))
            shift[axis] = _cut_px(aimed.project(mesh.vertices)[0][:, axis], (width_px, height_px)[axis], rng)
        turn = np.eye(4)
        aim = Rotation.from_rotvec([-shift[1] / focal_px, shift[0] / focal_px, 0.0])
        turn[:3, :3] = (Rotation.from_euler("z", ROLL_DEVIATION_DEG * rng.normal(), degrees=True) * aim).as_matrix()
        intrinsics = make_intrinsics(focal_px, width_px, height_px)
        cameras.append(Camera(f"{number:06d}.jpg", width_px, height_px, intrinsics, turn @ pose))
    return cameras


def _cut_px(places_px: np.ndarray, side_px: int, rng: np.random.Generator) -> float:
    """By how much a photo's content must move along one side for the border to cut the object, at (N,) `places_px`, off in part."""
    share = rng.uniform(*CUT_OFF)
    low, high = places_px.min(), places_px.max()
    if rng.uniform() < 0.5:
        return float(-low - share * (high - low))
    return float(side_px - high + share * (high - low))


def photograph(linear: np.ndarray, hard: bool, rng: np.random.Generator) -> np.ndarray:
    """(height, width, 3) uint8 photo of linear light, by an automatic exposure and white balance that are off a little, or more."""
    tint = np.exp((HARD_TINT_DEVIATION if hard else TINT_DEVIATION) * rng.normal(size=3)).astype(np.float32)
    level = rng.uniform(*(HARD_BRIGHT_LEVELS if hard else BRIGHT_LEVELS))
    light = linear * tint * np.float32(level / max(float(np.percentile(linear, 90)), 1e-6))
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), rng.uniform(*(HARD_BLUR_PX if hard else BLUR_PX))), np.float32)
    light += (HARD_NOISE if hard else NOISE) * np.sqrt(np.clip(light, 0.02, 1.0)) * rng.standard_normal(light.shape, dtype=np.float32)
    return expose(light, rng)


def _write_photo(path: Path, image: np.ndarray) -> None:
    done, content = cv2.imencode(path.suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 90])
    if not done:
        raise StepError(f"{path}: this OpenCV writes no JPEG; install opencv-python-headless")
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.tobytes())
