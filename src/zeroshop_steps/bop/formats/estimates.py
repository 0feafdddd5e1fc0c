"""Estimated poses in BOP's result CSV: scene_id,im_id,obj_id,score,R,t,time; one row per estimate."""

import codecs
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.pose_checks import check_rotations, check_translations
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_write

HEADER = "scene_id,im_id,obj_id,score,R,t,time"
NUMBERS = 17  # per row: three identifiers, the score, nine of R, three of t, the time
BLOCK_BYTES = 1 << 25  # read at a time: 32 MB, so that files of any size need little memory
LINE_BYTES = 10_000  # of one row at most; 17 numbers with all their digits take 450
SAME_TIME_S = 1e-3  # times of an image that differ by less are the same, rounded differently


@dataclass(frozen=True)
class Estimates:
    """Estimated poses, N of them, in the order of the file.

    Attributes:
        scene_ids, image_ids, object_ids: (N,) int64.
        scores: (N,) confidence; higher is more confident.
        rotations: (N, 3, 3) of camera_from_model.
        translations_mm: (N, 3) of camera_from_model.
        seconds: (N,) time spent on the image, the same for all of its estimates; -1 if unknown.
    """

    scene_ids: np.ndarray
    image_ids: np.ndarray
    object_ids: np.ndarray
    scores: np.ndarray
    rotations: np.ndarray
    translations_mm: np.ndarray
    seconds: np.ndarray

    def __len__(self) -> int:
        return len(self.scores)

    def seconds_per_image(self) -> float:
        """Mean time per image; -1 if a time is unknown or there is no estimate."""
        if len(self) == 0 or (self.seconds < 0).any():
            return -1.0
        _, first = np.unique(np.stack([self.scene_ids, self.image_ids]), axis=1, return_index=True)
        return float(self.seconds[first].mean())


def read_estimates(path: Path) -> Estimates:
    """Read a result CSV of any size in blocks. The header may be missing; an empty file has no estimates, and gives a warning.

    Raises:
        StepError: a row has another form, a number is not finite, an R is no rotation, t is in metres, or times
            differ within an image.
    """
    path = Path(path)
    if not path.is_file():
        raise StepError(f"result file {path} does not exist")
    blocks, size_bytes = [], path.stat().st_size
    with path.open("rb") as file:
        mark = file.read(len(codecs.BOM_UTF8))
        if mark.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise StepError(f"result file {path} is text in UTF-16; save it as CSV in UTF-8")
        start = len(codecs.BOM_UTF8) if mark == codecs.BOM_UTF8 else 0
        file.seek(start)
        line = first_line = 2 if _is_header(path, file.readline(LINE_BYTES)) else 1
        if first_line == 1:
            file.seek(start)
        while lines := file.readlines(BLOCK_BYTES):
            count = len(lines)
            if file.tell() == size_bytes:  # the file ends with blank lines
                while lines and not lines[-1].strip():
                    lines.pop()
            blocks.append(_parse(path, lines, line))
            line += count
    rows = np.concatenate(blocks) if blocks else np.empty((0, NUMBERS))
    estimates = _from_rows(rows)
    _check(path, estimates, rows, first_line)
    if not len(estimates):
        warn(f"result file {path} holds no estimates; every object counts as not found. Expected rows of {HEADER}")
    return estimates


def _is_header(path: Path, line: bytes) -> bool:
    """Whether the first line is the header. Raises StepError where it is another one."""
    found = line.decode(errors="replace").replace(" ", "").strip()
    if found.lower() == HEADER.lower():
        return True
    if found[:1].isalpha() and not found.lower().startswith(("nan", "inf")):
        raise StepError(
            f"{path}, line 1 is the header {found[:80]}; expected {HEADER}, in this order and separated by commas: write the columns so"
        )
    return False


def write_estimates(path: Path, estimates: Estimates) -> None:
    """Write a result CSV. Numbers have as many digits as are needed to read them back exactly."""
    with atomic_write(path) as temporary, temporary.open("w", newline="\n") as file:
        file.write(HEADER + "\n")
        for index in range(len(estimates)):
            rotation = " ".join(map(repr, estimates.rotations[index].ravel().tolist()))
            translation = " ".join(map(repr, estimates.translations_mm[index].tolist()))
            numbers = f"{estimates.scene_ids[index]},{estimates.image_ids[index]},{estimates.object_ids[index]}"
            score, seconds = float(estimates.scores[index]), float(estimates.seconds[index])
            file.write(f"{numbers},{score!r},{rotation},{translation},{seconds!r}\n")


def _parse(path: Path, lines: list[bytes], first_line: int) -> np.ndarray:
    """(N, 17) numbers of N lines, of which the first has the number `first_line`."""
    words: list[bytes] = []
    for offset, line in enumerate(lines):
        if len(line) > LINE_BYTES:
            raise StepError(f"{path}, line {first_line + offset} is {len(line)} bytes long; expected {NUMBERS} numbers: {HEADER}")
        fields = line.split(b",")
        if len(fields) != 7:
            what = f"has {len(fields)} fields" if line.strip() else "is empty, and more lines follow"
            raise StepError(f"{path}, line {first_line + offset} {what}; expected 7, separated by commas: {HEADER}")
        rotation, translation = fields[4].split(), fields[5].split()
        if len(rotation) != 9 or len(translation) != 3:
            _raise_for_line(path, line, first_line + offset)
        words += [*fields[:4], *rotation, *translation, fields[6]]
    try:
        return np.array(words, dtype="S").astype(np.float64).reshape(-1, NUMBERS)
    except ValueError:
        for offset, line in enumerate(lines):
            _raise_for_line(path, line, first_line + offset)
        raise


def _raise_for_line(path: Path, line: bytes, number: int) -> None:
    """Raise StepError if something is wrong with a line."""
    for field, name, count in zip(line.split(b","), HEADER.split(","), (1, 1, 1, 1, 9, 3, 1), strict=True):
        words = field.split()
        if len(words) != count:
            raise StepError(f"{path}, line {number}: {name} has {len(words)} numbers, expected {count}, separated by spaces")
        for word in words:
            try:
                float(word)
            except ValueError:
                raise StepError(
                    f"{path}, line {number}: {name} holds {word.decode(errors='replace')[:40]!r}, which is no number; numbers are"
                    " separated by spaces, without brackets or quotes"
                ) from None


def _from_rows(rows: np.ndarray) -> Estimates:
    scenes, images, objects = np.nan_to_num(rows[:, :3], nan=-1, posinf=-1, neginf=-1).astype(np.int64).T
    return Estimates(scenes, images, objects, rows[:, 3], rows[:, 4:13].reshape(-1, 3, 3), rows[:, 13:16], rows[:, 16])


def _check(path: Path, estimates: Estimates, rows: np.ndarray, first_line: int) -> None:
    if not len(estimates):
        return
    where = _Lines(first_line)
    wrong = np.flatnonzero((rows[:, :3] != np.stack([estimates.scene_ids, estimates.image_ids, estimates.object_ids], 1)).any(1))
    if len(wrong) or (rows[:, :3] < 0).any():
        first = wrong[0] if len(wrong) else np.flatnonzero((rows[:, :3] < 0).any(1))[0]
        raise StepError(f"{path}, {where[first]}: scene_id, im_id and obj_id must be whole numbers of 0 and more")
    for name, values in (("score", estimates.scores), ("time", estimates.seconds)):
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            raise StepError(f"{path}, {where[wrong[0]]}: {name} is {values[wrong[0]]}; expected a finite number")
    check_rotations(estimates.rotations, where, path)
    check_translations(estimates.translations_mm, where, path)
    _check_doubles(path, rows, where)
    _check_times(path, estimates, where)


def _check_doubles(path: Path, rows: np.ndarray, where: "_Lines") -> None:
    """Warn of rows that repeat another."""
    keys = np.ascontiguousarray(rows[:, [0, 1, 2, *range(4, 16)]]).view(np.dtype((np.void, 8 * 15))).ravel()
    _, first, counts = np.unique(keys, return_index=True, return_counts=True)
    if (counts > 1).any():
        index = first[counts > 1].min()
        again = np.flatnonzero(keys == keys[index])[1]
        warn(
            f"{path}, {where[again]} repeats the pose of {where[index]} ({int((counts - 1).sum())} rows repeat another); each counts as an"
            " estimate of its own, as in BOP's scoring"
        )


def _check_times(path: Path, estimates: Estimates, where: "_Lines") -> None:
    known = np.flatnonzero(estimates.seconds >= 0)
    images = np.stack([estimates.scene_ids, estimates.image_ids])[:, known]
    _, first, group = np.unique(images, axis=1, return_index=True, return_inverse=True)
    wrong = np.flatnonzero(np.abs(estimates.seconds[known] - estimates.seconds[known[first[group.ravel()]]]) > SAME_TIME_S)
    if len(wrong):
        index = known[wrong[0]]
        raise StepError(
            f"{path}, {where[index]}: the time differs from that of other estimates in scene {estimates.scene_ids[index]},"
            f" image {estimates.image_ids[index]}; give the seconds spent on the whole image in each of its rows"
        )


class _Lines:
    """Names of rows for messages, computed when needed."""

    def __init__(self, first_line: int) -> None:
        self.first_line = first_line

    def __getitem__(self, index: int) -> str:
        return f"line {self.first_line + int(index)}"
