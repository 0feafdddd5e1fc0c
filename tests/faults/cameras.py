"""Faults of the files that hold cameras."""

from pathlib import Path

from helpers.camera_ring import ring_camera
from helpers.faults import Fault
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, write_cameras


def make_cameras(folder: Path) -> Path:
    """A model of eight cameras."""
    ring = [ring_camera(index, 8, 500.0, (20.0, 40.0), (0.0, 0.0, 0.0), 500.0, (640, 480)) for index in range(8)]
    write_cameras(folder / "sparse", ring)
    return folder / "sparse"


def read_cut(folder: Path, name: str, left_bytes: int) -> None:
    """Read cameras of which one file is cut off."""
    file = make_cameras(folder) / name
    file.write_bytes(file.read_bytes()[:left_bytes])
    read_sparse_model(file.parent)


def read_with_a_huge_count(folder: Path, name: str) -> None:
    """Read cameras of which one file says that it holds 2^60 entries."""
    file = make_cameras(folder) / name
    file.write_bytes((1 << 60).to_bytes(8, "little") + file.read_bytes()[8:])
    read_sparse_model(file.parent)


DAMAGED = r"(is damaged or cut off|holds no readable COLMAP model).*run registration again"
NAMES = ("cameras.bin", "frames.bin", "images.bin", "points3D.bin", "rigs.bin")
FAULTS = [
    *(
        Fault(f"cut {name} ({left})", lambda folder, name=name, left=left: read_cut(folder, name, left), (DAMAGED, name))
        for name in NAMES
        for left in (0, 7)
    ),
    *(Fault(f"half of {name}", lambda folder, name=name: read_cut(folder, name, 20), (DAMAGED, name)) for name in NAMES[:3]),
    *(Fault(f"2^60 entries in {name}", lambda folder, name=name: read_with_a_huge_count(folder, name), (DAMAGED, name)) for name in NAMES),
]
