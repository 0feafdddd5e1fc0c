"""Middlebury's multi-view stereo data (Seitz et al., CVPR 2006): NAME_par.txt has K, R and t of each image, in metres.

https://vision.middlebury.edu/mview/data/: a line is `imgname.png k11 ... k33 r11 ... r33 t1 t2 t3`, and P = K [R t].
"""

from pathlib import Path

import numpy as np

from zeroshop_steps.capture.adapters.form import (
    Adapter,
    GivenFrame,
    ImportedCapture,
    ImportOptions,
    choose_unit,
    read_size_px,
    require_files,
    resolve_inside,
)
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.runtime.errors import StepError

NUMBERS = 21


def _find(folder: Path) -> Path | None:
    return next(iter(sorted(folder.glob("*_par.txt"))), None)


def recognizes(folder: Path) -> bool:
    """Whether a parameter file lies in a folder."""
    return _find(folder) is not None


def read(folder: Path, options: ImportOptions) -> ImportedCapture:
    """All images of the file."""
    path = _find(folder)
    assert path is not None
    rows = [line.split() for line in path.read_text(errors="replace").splitlines() if line.strip()]
    rows = rows[1:] if rows and len(rows[0]) == 1 else rows
    entries = []
    for row in rows:
        try:
            numbers = np.array(row[1:], float)
        except ValueError:
            numbers = np.zeros(0)
        if len(numbers) != NUMBERS:
            raise StepError(f"{path}: the line of {row[0]} has {len(row) - 1} numbers; expected {NUMBERS}: K, R and t, row by row")
        entries.append((resolve_inside(folder, row[0], path), numbers))
    if not entries:
        raise StepError(f"{path} lists no images; expected a line for each")
    require_files([file for file, _ in entries], path)
    frames = []
    for file, numbers in entries:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = numbers[9:18].reshape(3, 3), numbers[18:]
        frames.append(GivenFrame(file, Lens.pinhole(numbers[:9].reshape(3, 3), read_size_px(file), 0.5), pose))
    return ImportedCapture(frames, path.name, choose_unit(options, "m"))


ADAPTER = Adapter("Middlebury's multi-view data", "NAME_par.txt beside its images", recognizes, read, 4)
