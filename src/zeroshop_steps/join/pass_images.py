"""The images of several passes side by side: each keeps its name, after the number of its pass."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import pycolmap

from zeroshop_steps.geometry.cameras.registered_views import CONFIDENCE
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.runtime.errors import StepError


@dataclass(frozen=True)
class Pass:
    """One pass: the registered images of the object as it lay then.

    Attributes:
        number: 1 for the first, whose frame stays.
        model: its cameras (PINHOLE) and sparse points, with the images' joint names.
        images, masks: {joint name: file}.
    """

    number: int
    model: pycolmap.Reconstruction
    images: dict[str, Path]
    masks: dict[str, Path]


def make_joint_name(number: int, name: str) -> str:
    """The name of an image of a pass among those of all passes."""
    return f"{number}_{name}"


def read_pass(number: int, cameras: Path) -> Pass:
    """Read a pass from a folder of registered cameras with masks.

    Raises:
        StepError: the registration failed, or there are no masks.
    """
    cameras = Path(cameras)
    model = read_reconstruction(cameras / "sparse")
    if not (cameras / "masks").is_dir():
        raise StepError(f"{cameras} has no masks; passes are joined by the object alone, so each needs its masks: segment it first")
    images, masks = {}, {}
    for image in model.images.values():
        source = image.name
        image.name = make_joint_name(number, source)
        images[image.name] = cameras / "images" / source
        masks[image.name] = cameras / "masks" / f"{Path(source).stem}.png"
    return Pass(number, model, images, masks)


def repeats(first: Pass, other: Pass) -> bool:
    """Whether most pictures of a pass are those of the first: the same capture was given twice."""
    known = {path.read_bytes() for path in first.images.values()}
    same = sum(path.read_bytes() in known for path in other.images.values())
    return same > len(other.images) / 2


def gather(passes: list[Pass], out: Path) -> ImageSet:
    """Copy the images and masks of all passes, and how sure the masks are, into `out`; they are listed pass by pass."""
    paths, masks, sizes_px = [], [], []
    for folder in ("images", "masks"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    for one in passes:
        for name in sorted(one.images):
            paths.append(Path(shutil.copyfile(one.images[name], out / "images" / name)))
            masks.append(Path(shutil.copyfile(one.masks[name], out / "masks" / f"{Path(name).stem}.png")))
            confidence = one.masks[name].parent.with_name(CONFIDENCE) / one.masks[name].name
            if confidence.is_file():
                (out / CONFIDENCE).mkdir(exist_ok=True)
                shutil.copyfile(confidence, out / CONFIDENCE / masks[-1].name)
            height, width = read_image(paths[-1]).shape[:2]
            sizes_px.append((width, height))
    return ImageSet(tuple(paths), tuple(masks), tuple(sizes_px))
