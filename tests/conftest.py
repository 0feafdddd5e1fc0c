"""How all tests are run, and fixtures that several stages share.

The process that only hands tests to others reads this file, too, and they wait for it: what takes long to import is imported where it
is used.
"""

import os
import shutil
from pathlib import Path

import pytest

from helpers.paths import REPOSITORY

KERNELS = REPOSITORY / ".pytest_cache" / "numba"
"""Compiled kernels, in a folder for each process."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(specs) -> None:
    """Each process has compiled kernels of its own: two that write into numba's index of one function could mix up its signatures.

    At the start it gets those that the others compiled last time, as the same test may now run in another process.
    """
    for spec in specs:
        spec.env["NUMBA_CACHE_DIR"] = str(KERNELS / spec.id)
        _take_kernels(KERNELS / spec.id)


def _take_kernels(folder: Path) -> None:
    """Copy every function that another process compiled later, or alone: its index and the files that this names."""
    for index in sorted(KERNELS.glob("*/*/*.nbi")):
        own = folder / index.parent.name / index.name
        if not own.exists() or own.stat().st_mtime < index.stat().st_mtime:
            own.parent.mkdir(parents=True, exist_ok=True)
            for file in [*index.parent.glob(f"{index.stem}.*.nbc"), index]:
                shutil.copy2(file, own.parent / file.name)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Every test starts with one thread: images this small gain nothing from a second one, and lose much on a busy machine.

    A step that an earlier test called may have asked for more. Where threads matter, the test asks for its own.
    """
    import numba
    import torch

    numba.set_num_threads(1)
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real data beside the checkout; tests that need it are skipped where it is absent."""
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real data (../shared/data) is not on this machine")
    return folder


@pytest.fixture(scope="session")
def carton(tmp_path_factory):
    """A small printed carton on a table with its cameras (carton_scene.py)."""
    from helpers.carton_scene import photographed_carton

    return photographed_carton(tmp_path_factory.mktemp("carton"))


@pytest.fixture(scope="session")
def carton_capture(tmp_path_factory) -> Path:
    """The raised ring of ten views (480 x 360) around a printed carton on a textured surface, with true cameras."""
    from zeroshop_steps.geometry.cameras import read_sparse_model, write_cameras
    from zeroshop_steps.synthetic.demo_objects import write_demo_object
    from zeroshop_steps.synthetic.raycast import capture

    folder = tmp_path_factory.mktemp("register")
    write_demo_object("gelatin_carton", folder / "model")
    capture(folder / "model" / "model.ply", "su_h", 480, 360, 0, folder / "whole")
    ring = folder / "ring"
    names = [f"{index:06d}.png" for index in range(10, 20)]
    for part in ("images", "masks", "depth"):
        (ring / part).mkdir(parents=True)
        for name in names:
            shutil.copy(folder / "whole" / part / name, ring / part / name)
    cameras = read_sparse_model(folder / "whole" / "truth").cameras
    write_cameras(ring / "truth", [camera for camera in cameras if camera.name in names])
    return ring


@pytest.fixture(scope="session")
def blender() -> Path:
    """The record of BlenderProc's environment; tests that need it are skipped where it was not set up."""
    record = Path(os.environ.get("ZEROSHOP_BLENDERPROC") or REPOSITORY / "resources/envs/blenderproc.json")
    if not record.is_file():
        pytest.skip("BlenderProc is not set up (snakemake resources/envs/blenderproc.json), nor named in ZEROSHOP_BLENDERPROC")
    return record
