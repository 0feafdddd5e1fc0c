"""COLMAP projects: a sparse model, binary or text, beside its images. Its unit is arbitrary unless somebody says otherwise."""

from pathlib import Path

from zeroshop_steps.capture.adapters.form import (
    Adapter,
    GivenFrame,
    ImportedCapture,
    ImportOptions,
    choose_unit,
    require_files,
    resolve_inside,
)
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.geometry.cameras.pinhole import to_matrix
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.imaging.images import IMAGE_SUFFIXES
from zeroshop_steps.runtime.errors import StepError

MODELS = ("sparse", "sparse/*", "colmap/sparse/*", "colmap/sparse", "dense/sparse", "dense/*/sparse", ".")
IMAGES = ("images", "dense/images", "input", "rgb", ".")


def _list_models(folder: Path) -> list[Path]:
    found = [path for pattern in MODELS for path in ([folder] if pattern == "." else sorted(folder.glob(pattern)))]
    return [
        path
        for path in found
        if any((path / f"cameras{kind}").is_file() and (path / f"images{kind}").is_file() for kind in (".bin", ".txt"))
    ]


def recognizes(folder: Path) -> bool:
    """Whether a sparse model lies where COLMAP and its users put it."""
    return bool(_list_models(folder))


def read(folder: Path, options: ImportOptions) -> ImportedCapture:
    """The registered images of the largest model."""
    models = {path: read_reconstruction(path) for path in _list_models(folder)}
    path, model = max(models.items(), key=lambda one: one[1].num_reg_images())
    placed = sorted((model.images[number] for number in model.reg_image_ids()), key=lambda image: image.name)
    if not placed:
        raise StepError(f"{path} has no image with a pose; run COLMAP's mapper first")
    roots = [folder / name for name in IMAGES]
    root = next((root for root in roots if _find_image(root, placed[0].name, path).is_file()), roots[0])
    files = [_find_image(root, image.name, path) for image in placed]
    require_files(files, path)
    frames = []
    for file, image in zip(files, placed, strict=True):
        camera = model.cameras[image.camera_id]
        lens = Lens(camera.model.name, camera.width, camera.height, tuple(map(float, camera.params)))
        frames.append(GivenFrame(file, lens, to_matrix(image.cam_from_world()), _find_mask(folder, image.name)))
    metres = choose_unit(options, "unknown")
    warnings = [] if metres else ["COLMAP's unit is arbitrary, so the size stays unknown; if it was aligned to metres, say --unit m"]
    if len(models) > 1:
        warnings.append(f"{folder} holds {len(models)} models; the largest is taken, {path} with {len(placed)} images")
    return ImportedCapture(frames, f"COLMAP project {folder.name}", metres, tuple(warnings))


def _find_image(root: Path, name: str, model: Path) -> Path:
    """The file of an image; one that was converted since has another suffix."""
    path = resolve_inside(root, name, model)
    converted = (path.with_suffix(suffix) for suffix in (*IMAGE_SUFFIXES, *map(str.upper, IMAGE_SUFFIXES)))
    return path if path.is_file() else next((other for other in converted if other.is_file()), path)


def _find_mask(folder: Path, name: str) -> Path | None:
    """The mask of an image, named as COLMAP does (x.jpg.png), or x.png."""
    places = (folder / "masks" / f"{name}.png", folder / "masks" / Path(name).with_suffix(".png"))
    return next((path for path in places if path.is_file()), None)


ADAPTER = Adapter("a COLMAP project", "cameras and images, .bin or .txt, in sparse/ or sparse/0, beside images/", recognizes, read, 6)
