"""FoundationPose's demo folders: rgb/, depth/ in millimetres, masks/ and cam_K.txt. They have no poses: cameras are estimated, depth gives
the size."""

from pathlib import Path

import numpy as np

from zeroshop_steps.capture.adapters.form import Adapter, GivenFrame, ImportedCapture, ImportOptions, read_size_px
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.capture.photo_files import list_photos
from zeroshop_steps.runtime.errors import StepError


def recognizes(folder: Path) -> bool:
    """Whether a camera matrix lies beside colour images."""
    return (folder / "cam_K.txt").is_file() and (folder / "rgb").is_dir()


def read(folder: Path, options: ImportOptions) -> ImportedCapture:
    """All colour images; where only some have a mask, as the tracker needs just the first, masks are left alone."""
    path = folder / "cam_K.txt"
    try:
        intrinsics = np.loadtxt(path).reshape(3, 3)
    except ValueError as error:
        raise StepError(f"{path} holds no 3 x 3 matrix ({error}); expected K row by row") from None
    if not (np.isfinite(intrinsics).all() and intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0):
        raise StepError(f"{path} has no positive focal lengths; expected K row by row, in pixels")
    images = list_photos(folder / "rgb")[0]
    masks = {image: mask for image in images if (mask := _find(folder, ("masks", "mask"), image))}
    warnings = ["cam_K.txt comes without poses: cameras are estimated, and depth gives the size"]
    if masks and len(masks) < len(images):
        warnings.append(f"only {len(masks)} of {len(images)} images have a mask; masks are found instead")
        masks = {}
    frames = [
        GivenFrame(image, Lens.pinhole(intrinsics, read_size_px(image), 0.5), None, masks.get(image), _find(folder, ("depth",), image), 1.0)
        for image in images
    ]
    return ImportedCapture(frames, f"FoundationPose folder {folder.name}", 1.0, tuple(warnings))


def _find(folder: Path, kinds: tuple[str, ...], image: Path) -> Path | None:
    places = (folder / kind / f"{image.stem}{suffix}" for kind in kinds for suffix in (".png", ".npy", ".tif", ".tiff", ".exr"))
    return next((path for path in places if path.is_file()), None)


ADAPTER = Adapter("a FoundationPose folder", "cam_K.txt, rgb/, depth/, masks/", recognizes, read, 2)
