"""Photos with masks that are right: of the benchmark's rendered captures, and of folders."""

from dataclasses import dataclass
from pathlib import Path

from capture_benchmark.inputs import find_inputs
from capture_benchmark.table import choose_captures, read_captures
from zeroshop_steps.capture.photo_files import list_photos
from zeroshop_steps.geometry.imaging.images import list_images
from zeroshop_steps.runtime.errors import StepError

TABLE = Path(__file__).parent / "captures/captures.csv"


@dataclass(frozen=True)
class MaskedPhoto:
    """A photo, the file of its mask, which may be smaller, and the name of the capture that it is of."""

    capture: str
    photo: Path
    mask: Path


def find_rendered(inputs: Path, half: str) -> list[MaskedPhoto]:
    """All photos of one half of the rendered captures that the benchmark stored in its folder of inputs.

    Raises:
        StepError: there are none, or a mask belongs to no photo.
    """
    rendered = [one for one in choose_captures(read_captures(TABLE), half, []) if one.kind == "rendered"]
    folders = {one.name: find_inputs(inputs, one) / "capture" for one in rendered}
    found = {name: folder for name, folder in folders.items() if (folder / "truth/masks").is_dir()}
    if not found:
        raise StepError(
            f"{inputs} holds no rendered captures of the half {half}; `captures.py --stages inputs --inputs {inputs}` makes them"
        )
    return [one for name, folder in found.items() for one in pair_folders(name, folder / "images", folder / "truth/masks")]


def pair_folders(name: str, photos: Path, masks: Path) -> list[MaskedPhoto]:
    """The photos of a capture that have a mask, by their stems.

    Raises:
        StepError: a folder is missing or empty, or a mask belongs to no photo.
    """
    by_stem = {path.stem: path for path in list_photos(photos)[0]}
    files = list_images(masks)
    if unknown := [path.name for path in files if path.stem not in by_stem]:
        raise StepError(f"{masks}: no photo in {photos} belongs to {', '.join(unknown)}; name masks as their photos, but .png")
    return [MaskedPhoto(name, by_stem[path.stem], path) for path in files]
