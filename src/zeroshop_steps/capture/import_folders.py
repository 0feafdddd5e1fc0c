"""Import folders of the thesis's published pipeline: a row of the table of photos for each, and a list of what to compare.

Each folder is an object, by its name. It must have images and masks (folders images or input, masks or mask), and may have COLMAP
cameras (sparse/0 or sparse) and meshes (.ply or .obj, anywhere below). Masks may have any names that photos take, such as photo.jpg.png of
COLMAP (`mask_names.py`). Heights are the z extents of the meshes, which that pipeline scales to the height that it was given: in
millimetres; 200 mm is what it takes where none was given, so such a height is left out.
"""

import argparse
import shlex
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.mask_names import find_masks
from zeroshop_steps.geometry.imaging.images import list_images
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_write

IMAGES, MASKS, CAMERAS = ("images", "input"), ("masks", "mask"), ("sparse/0", "sparse")
COLUMNS = ("dataset", "object", "images", "masks", "height_m")
ASSUMED_MM = 200.0
"""The height that the published pipeline takes where none is given."""
SAME_MM = 0.05


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--folders", type=Path, nargs="+", required=True, help="one folder an object")
    parser.add_argument("--dataset", default="photos", help="dataset of the rows (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="table of photos to write; objects_table in the config names it")


def run(args: argparse.Namespace) -> None:
    """Write the table, and print the commands that compare meshes once the workflow has made ours."""
    rows, commands = [], []
    for folder in args.folders:
        images, masks = find_folder(folder, IMAGES), find_folder(folder, MASKS)
        check_masks(images, masks)
        name, meshes = folder.resolve().name, find_meshes(folder)
        height = find_height_m(meshes)
        rows.append((args.dataset, name, str(images.resolve()), str(masks.resolve()), f"{height:.4f}" if height else ""))
        cameras = next((folder / place for place in CAMERAS if (folder / place / "cameras.bin").is_file()), None)
        commands += [make_command(args.dataset, name, mesh, cameras) for mesh in meshes]
    with atomic_write(args.out) as temporary:
        temporary.write_text("\n".join("\t".join(row) for row in [COLUMNS, *rows]) + "\n", encoding="utf-8")
    print(f"{args.out}: {len(rows)} objects. Once their meshes are made, compare:", *commands, sep="\n")


def find_folder(folder: Path, names: tuple[str, ...]) -> Path:
    """The folder of one of these names in a folder. Raises StepError if there is none."""
    found = next((folder / name for name in names if (folder / name).is_dir()), None)
    if found is None:
        raise StepError(f"{folder} has no folder {' or '.join(names)}; an imported object needs images and masks")
    return found


def check_masks(images: Path, masks: Path) -> None:
    """Raise StepError where a photo has no mask."""
    photos = list_images(images)
    names = find_masks(photos, masks)
    if lacking := [photo for photo in photos if photo not in names.found]:
        more = " ..." if len(lacking) > 3 else ""
        raise StepError(f"{masks} has no mask of {', '.join(photo.name for photo in lacking[:3])}{more}: {names.expect(lacking[0], masks)}")


def find_meshes(folder: Path) -> list[Path]:
    """Its meshes: .ply with faces, so no point clouds, and .obj."""
    found = [path for path in sorted(folder.rglob("*.obj")) + sorted(folder.rglob("*.ply")) if path.is_file()]
    return [path for path in found if path.suffix == ".obj" or has_faces(path)]


def has_faces(path: Path) -> bool:
    """Whether the header of a PLY says so."""
    with path.open("rb") as file:
        header = file.read(4096).split(b"end_header")[0]
    return any(line.split()[:2] == [b"element", b"face"] and int(line.split()[2]) > 0 for line in header.splitlines() if line.split())


def find_height_m(meshes: list[Path]) -> float | None:
    """The z extent of its last PLY in metres; None if there is none, or where it is the height that was assumed."""
    tables = [path for path in meshes if path.suffix == ".ply"]
    if not tables:
        return None
    size_mm = float(np.ptp(read_ply(tables[-1]).vertices[:, 2]))
    if not 5.0 <= size_mm <= 3000.0:
        warn(f"{tables[-1]} is {size_mm:g} high, which is no height in millimetres; the row has none")
        return None
    if abs(size_mm - ASSUMED_MM) < SAME_MM:
        warn(f"{tables[-1]} is {size_mm:g} mm high, what the published pipeline takes for unknown heights; the row has none")
        return None
    return size_mm / 1000


def make_command(dataset: str, name: str, mesh: Path, cameras: Path | None) -> str:
    """The command that compares one of its meshes with ours."""
    ours = f"results/{dataset}/{name}/2dgs.ply"
    words = f"--meshes {ours} --others {shlex.quote(str(mesh))}"
    if cameras:
        words += f" --cameras results/{dataset}/{name}/video/colmap/cameras/sparse --other-cameras {shlex.quote(str(cameras))}"
    return f"python -m zeroshop_steps.evaluate --method compare_meshes {words} --out results/{dataset}/{name}/comparison.csv"
