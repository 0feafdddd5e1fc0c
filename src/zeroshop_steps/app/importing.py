"""What a path is: photos, a film, the common form of a capture with cameras, or what an adapter brings into that form."""

import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path

from zeroshop_steps.capture.adapters import list_known, recognize
from zeroshop_steps.capture.adapters.form import ImportOptions, write_common_form
from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.capture.photo_files import list_photos
from zeroshop_steps.geometry.imaging.image_files import list_folder
from zeroshop_steps.methods import HEIGHTS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

IMPORTED = Path("results") / "imported"
STAMP = "imported_from.txt"
BY_DEPTH = next(name for name, method in HEIGHTS.items() if "depth" in method.columns)


@dataclass(frozen=True)
class Source:
    """What a capture consists of, as columns of the table of objects; what is empty is not there.

    Attributes:
        images: folder of photos, or a film.
        masks, depth: folders beside it.
        cameras: cameras.json.
        poses: whether that knows the poses, too, rather than lenses alone.
        height_method: by which the capture itself gives the size.
    """

    images: Path
    masks: str = ""
    cameras: str = ""
    poses: bool = False
    depth: str = ""
    height_method: str = ""


def import_capture(path: Path, out: Path, options: ImportOptions, *deviations: float | None) -> str:
    """Bring what lies at a path into the common form; returns what it was, in words.

    Args:
        path: a folder that an adapter knows.
        out: folder to write.
        options: what the folder does not say.
        deviations: of the cameras' places in metres, and of their turns in degrees.

    Raises:
        StepError: no adapter knows it, or it cannot be read.
    """
    adapter = recognize(path, options.board)
    if adapter is None:
        raise StepError(f"{path} is nothing that can be imported. Known are: {list_known()}")
    if out.exists() and not (out.is_dir() and ((out / FILE).is_file() or not any(out.iterdir()))):
        raise StepError(f"{out} holds something else than an imported capture; name a new folder with --out")
    if out.resolve() == path.resolve() or path.resolve().is_relative_to(out.resolve()):
        raise StepError(f"{out} is or holds what is imported; name another folder with --out")
    write_common_form(adapter.read(path, options), out, *deviations)
    return adapter.title


def find_source(path: Path, folder: Path, name: str) -> Source:
    """What a path brings; a format of others is imported below `folder` first, unless that was done and nothing changed since.

    Raises:
        StepError: it is nothing that is known; lists what is.
    """
    if (path / FILE).is_file() and (path / "images").is_dir():
        return _read_common_form(path)
    adapter = recognize(path)
    if adapter is not None:
        out = folder / IMPORTED / name
        print(f"{path} is {adapter.title}: imported to {out}", file=sys.stderr)
        stamp = _describe_files(path)
        if not (out / STAMP).is_file() or (out / STAMP).read_text() != stamp:
            import_capture(path, out, ImportOptions())
            with atomic_write(out / STAMP) as temporary:
                temporary.write_text(stamp)
        return _read_common_form(out)
    if not path.is_dir():
        return Source(path)
    try:
        list_photos(path)
    except StepError as error:
        raise StepError(f"{error}. Known are: {list_known()}") from None
    return Source(path)


def brings_poses(cameras: str) -> bool:
    """Whether a capture brings poses, by its column `cameras`; also where the file is gone since. Raises StepError where it is wrong."""
    path = Path(cameras)
    return bool(cameras) and (not path.is_file() or read_given_cameras(path).has_poses)


def _read_common_form(folder: Path) -> Source:
    given = read_given_cameras(folder / FILE)
    parts = {part: str(folder / part) if (folder / part).is_dir() and list_folder(folder / part) else "" for part in ("masks", "depth")}
    method = BY_DEPTH if parts["depth"] and not (given.has_poses and given.metric) else ""
    said = [f"{len(given.poses)} of {len(given.images)} cameras", *(part for part, place in parts.items() if place)]
    print(f"{folder} brings {', '.join(said)} ({given.source})", file=sys.stderr)
    return Source(folder / "images", **parts, cameras=str(folder / FILE), poses=given.has_poses, height_method=method)


def _describe_files(path: Path) -> str:
    """The path, and a digest of the names, sizes and times of all files below it, or of its own."""
    digest = hashlib.sha256()
    for file in [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file()):
        status = file.stat()
        digest.update(f"{file} {status.st_size} {status.st_mtime_ns}\n".encode(errors="surrogateescape"))
    return f"{path}\n{digest.hexdigest()}\n"
