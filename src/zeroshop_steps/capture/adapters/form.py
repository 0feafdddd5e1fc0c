"""What an adapter reads, and how it is written in the common form."""

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from zeroshop_steps.capture.cameras_json import FILE, GivenCamera, GivenCameras, Lens, check_pose
from zeroshop_steps.capture.photo_files import UPRIGHT, open_picture
from zeroshop_steps.geometry.imaging.depth_images import check_unit, depth_to_mm, read_exr
from zeroshop_steps.geometry.imaging.images import DEPTH_STEP_MM, decode_image, write_image
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory
from zeroshop_steps.runtime.progress import track

UNITS_M = {"m": 1.0, "mm": 0.001, "unknown": None}
"""Metres of the units that poses may have."""
AS_THEY_ARE = {"JPEG": ".jpg", "PNG": ".png"}
MOST_NAMED = 5
OFF_CENTRE = 0.2  # of the image's sides; cameras are built to have the lens's centre in the middle
EXIF_ORIENTATION = 274


@dataclass(frozen=True)
class ImportOptions:
    """What a folder does not say itself.

    Attributes:
        unit: of the poses, a key of `UNITS_M`; None where the format says it.
        object_id: of the object, where several are annotated.
        board: the board around the object, as `read_board` takes it.
        topic: of a bag's colour images; None takes those with most pixels.
    """

    unit: str | None = None
    object_id: int | None = None
    board: str | None = None
    topic: str | None = None


@dataclass(frozen=True)
class GivenFrame:
    """One picture.

    Attributes:
        image: its file.
        lens: of its pixels as they are stored.
        camera_from_world: (4, 4), OpenCV axes, in the unit of the capture; None where it is not known, and not finite where it was lost.
        mask, depth: files of its size; None without. In depth, 0 and what is not finite was not measured.
        depth_step_mm: millimetres a step of the depth.
    """

    image: Path
    lens: Lens
    camera_from_world: np.ndarray | None = None
    mask: Path | None = None
    depth: Path | None = None
    depth_step_mm: float = 1.0


@dataclass(frozen=True)
class ImportedCapture:
    """What an adapter read.

    Attributes:
        frames: the pictures.
        source: what they come from, in words.
        metres: of a unit of the poses; None where that is unknown.
        warnings: for the user.
        unpacked: holds files of the frames that were in an archive, until they are written.
    """

    frames: Sequence[GivenFrame]
    source: str
    metres: float | None = 1.0
    warnings: tuple[str, ...] = ()
    unpacked: tempfile.TemporaryDirectory | None = None


@dataclass(frozen=True)
class Adapter:
    """One format.

    Attributes:
        title: in words, with an article.
        expects: the files by which it is recognized.
        recognizes: whether a folder or file is of this format.
        read: reads it; raises StepError with what is wrong.
        rank: the lowest is asked first.
    """

    title: str
    expects: str
    recognizes: Callable[[Path], bool]
    read: Callable[[Path, ImportOptions], ImportedCapture]
    rank: int = 10


def choose_unit(options: ImportOptions, usual: str) -> float | None:
    """Metres of a unit of the poses. Raises StepError for an unknown unit."""
    unit = options.unit or usual
    if unit not in UNITS_M:
        raise StepError(f"--unit is {unit}; expected {', '.join(UNITS_M)}")
    return UNITS_M[unit]


def resolve_inside(root: Path, named: str, file: Path) -> Path:
    """The file that another one names. Raises StepError for an absolute path, or one that leads out of the folder."""
    if Path(named).is_absolute() or (len(named) > 1 and named[1] == ":") or named.startswith("\\"):
        raise StepError(
            f"{file} names {named}: an absolute path, of the machine that wrote it; make the paths relative to {root}, where the images"
            " must lie"
        )
    path = root / named
    if not path.resolve().is_relative_to(root.resolve()):
        raise StepError(f"{file} names {named}, which leads out of {root} and is not followed; put the file into that folder")
    return path


def require_files(paths: Sequence[Path], file: Path) -> None:
    """Raise StepError where files that another one names are missing."""
    missing = [path for path in paths if not path.is_file()]
    if missing:
        named = ", ".join(path.name for path in missing[:MOST_NAMED])
        more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
        raise StepError(
            f"{file} names {len(paths)} images, {len(missing)} of them are missing in {missing[0].parent}: {named}{more}; copy them there,"
            " or take their entries out"
        )


def read_size_px(image: Path) -> tuple[int, int]:
    """(width, height) of an image as it is stored."""
    with open_picture(image) as opened:
        return opened.size


def write_common_form(
    found: ImportedCapture, out: Path, position_deviation_m: float | None = None, rotation_deviation_deg: float | None = None
) -> None:
    """Write images/, masks/ and depth/, where there are any, and cameras.json to a folder, which is replaced.

    Raises:
        StepError: names the image whose lens, pose, mask or depth does not fit, or the half of the poses that are lost.
    """
    if not found.frames:
        raise StepError(f"{found.source} has no images; expected at least one")
    names, medians_mm = _choose_names([frame.image for frame in found.frames]), []
    for line in found.warnings:
        warn(line)
    with found.unpacked or nullcontext(), atomic_directory(out) as folder:
        cameras = {}
        for name, frame in track(list(zip(names, found.frames, strict=True)), "importing", len(names)):
            used = _write_picture(frame.image, folder / "images" / name)
            cameras[used] = GivenCamera(_fit_lens(frame), _scale_pose(frame, found))
            if frame.mask is not None:
                (folder / "masks").mkdir(exist_ok=True)
                shutil.copyfile(frame.mask, folder / "masks" / f"{name}{frame.mask.suffix}")
            if frame.depth is not None:
                depth_mm = read_depth_mm(frame)
                if (depth_mm > 0).any():
                    medians_mm.append(float(np.median(depth_mm[depth_mm > 0])))
                steps = np.round(depth_mm / DEPTH_STEP_MM)
                write_image(folder / "depth" / f"{name}.png", np.where(steps < 2**16, steps, 0).astype(np.uint16))
        what = f"{found.source}: depth, at {next((frame.depth_step_mm for frame in found.frames if frame.depth), 1.0):g} mm a step,"
        check_unit(np.array(medians_mm), what, "export it in the unit that its format says")
        _tell_odd_lenses(list(cameras.values()), found)
        lost = [
            frame.image.name
            for frame in found.frames
            if frame.camera_from_world is not None and not np.isfinite(frame.camera_from_world).all()
        ]
        if len(lost) * 2 >= len(found.frames):
            raise StepError(
                f"{found.source}: {len(lost)} of {len(found.frames)} poses hold NaN or no numbers, such as that of {lost[0]}; what wrote"
                " them lost track: record again, or give the images alone, whose cameras are then estimated"
            )
        if lost:
            warn(f"{len(lost)} of {len(found.frames)} poses hold no numbers, and count as unknown: {', '.join(lost[:MOST_NAMED])}")
        deviations = (position_deviation_m, rotation_deviation_deg) if found.metres else (None, rotation_deviation_deg)
        step_mm = DEPTH_STEP_MM if any(frame.depth for frame in found.frames) else None
        GivenCameras(cameras, found.source, found.metres is not None, *deviations, step_mm).write(folder / FILE)


def _tell_odd_lenses(cameras: Sequence[GivenCamera], found: ImportedCapture) -> None:
    """Warn where a lens's centre is far from the middle of its images: the matrix was calibrated for images of another size."""
    for lens in dict.fromkeys(camera.lens for camera in cameras):
        model = lens.to_colmap()
        centre = np.array([model.principal_point_x, model.principal_point_y])
        if (np.abs(centre / (lens.width_px, lens.height_px) - 0.5) > OFF_CENTRE).any():
            warn(
                f"{found.source}: the centre of a lens lies at ({centre[0]:.0f}, {centre[1]:.0f}) in images of {lens.width_px} x"
                f" {lens.height_px} px: if they were not cropped, its matrix is of images of another size; calibrate anew, or scale it"
            )
            return


def read_depth_mm(frame: GivenFrame) -> np.ndarray:
    """(height, width) float32 mm of a frame's depth, 0 where nothing was measured: PNG of 16 bits, TIFF, EXR, or NPY.

    Raises:
        StepError: it cannot be read, or has another shape than the image.
    """
    path = frame.depth
    assert path is not None
    if path.suffix.lower() == ".npy":
        try:
            raw = np.load(path, allow_pickle=False)
        except (ValueError, OSError) as error:
            raise StepError(f"depth {path} cannot be read as NPY ({error}); export it again") from None
        raw = raw.reshape(raw.shape[:2]) if raw.ndim == 3 and raw.shape[2] == 1 else raw
    elif path.suffix.lower() == ".exr":
        raw = read_exr(path)
    else:
        raw = decode_image(path, cv2.IMREAD_UNCHANGED)
    size_px = read_size_px(frame.image)
    if raw.ndim != 2 or raw.shape != size_px[::-1]:
        raise StepError(
            f"depth {path} has the shape {raw.shape}, its image {frame.image.name} {size_px[0]} x {size_px[1]} px; export depth of one"
            " channel that is aligned to the colour image"
        )
    if raw.dtype == np.uint8:
        raise StepError(f"depth {path} has 8 bits: it is a picture of depth, not depth; export PNG of 16 bits, TIFF, EXR or NPY")
    measured = depth_to_mm(raw, frame.depth_step_mm, f"depth {path}")
    return np.where(np.isfinite(measured) & (measured > 0), measured, 0.0).astype(np.float32)


def _choose_names(images: Sequence[Path]) -> list[str]:
    """A stem for each image: its own, with its folder's where several have the same."""
    stems = [path.stem for path in images]
    if len(set(stems)) < len(stems):
        stems = [f"{path.parent.name}_{path.stem}" for path in images]
    if len(set(stems)) < len(stems):
        raise StepError(f"several images are called {next(stem for stem in stems if stems.count(stem) > 1)}; give each a name of its own")
    return stems


def _write_picture(source: Path, target: Path) -> str:
    """Copy a picture as it is stored, JPEG and PNG with their bytes; returns its name. Lenses are those of stored pixels."""
    target.parent.mkdir(exist_ok=True)
    with open_picture(source) as image:
        turned = image.getexif().get(EXIF_ORIENTATION, UPRIGHT) != UPRIGHT
        suffix = AS_THEY_ARE.get(str(image.format), ".png")
        target = target.with_name(target.name + suffix)
        if str(image.format) in AS_THEY_ARE and not turned:
            shutil.copyfile(source, target)
        else:
            exif: Mapping[int, Any] = image.getexif()
            Image.fromarray(np.asarray(image.convert("RGB"))).save(
                target, quality=97, exif=_without_orientation(exif) if suffix == ".jpg" else b""
            )
    return target.name


def _without_orientation(exif: Any) -> Any:
    if EXIF_ORIENTATION in exif:
        del exif[EXIF_ORIENTATION]
    return exif


def _fit_lens(frame: GivenFrame) -> Lens:
    """The lens for the image as it is, which may have been reduced since."""
    size_px, lens = read_size_px(frame.image), frame.lens
    if (lens.width_px, lens.height_px) == size_px:
        return lens
    if abs(lens.width_px * size_px[1] - lens.height_px * size_px[0]) > 2 * max(size_px):
        raise StepError(
            f"image {frame.image} has {size_px[0]} x {size_px[1]} px, its lens is of {lens.width_px} x {lens.height_px} px: it was turned"
            " or cropped, or belongs to another camera"
        )
    return lens.resized(*size_px)


def _scale_pose(frame: GivenFrame, found: ImportedCapture) -> np.ndarray | None:
    if frame.camera_from_world is None or not np.isfinite(frame.camera_from_world).all():
        return None
    pose = check_pose(frame.camera_from_world, f"{found.source}, image {frame.image.name}")
    pose[:3, 3] *= found.metres or 1.0
    return pose
