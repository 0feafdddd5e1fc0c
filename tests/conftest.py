"""How all tests are run, and fixtures that several stages share.

The process that only hands tests to others reads this file, too, and they wait for it: what takes long to import is imported where it
is used.
"""

import fcntl
import gc
import os
from pathlib import Path

import pytest

from helpers.paths import REPOSITORY
from zeroshop_steps.runtime.compute.freed_memory import keep_freed_memory

KERNELS = REPOSITORY / ".pytest_cache" / "numba"
"""Compiled kernels, in a folder for each process."""


FIRST = (
    "surface/twodgs/test_train.py",
    "surface/svraster/test_render.py",
    "surface/test_stereo.py",
    "synthetic/test_raycast.py",
    "pose/test_render_compare.py",
    "workflow/test_tiny_cell.py",
    "height/test_marker.py",
    "segment/test_finder.py",
    "bop/test_align.py",
    "register/test_silhouette_sfm.py",
    "evaluate/test_grade.py",
    "workflow/test_shared_cache.py",
    "register/test_aliked.py",
    "join/test_passes.py",
    "simulate/test_arm.py",
    "surface/test_kernels.py",
    "finish/test_generated.py",
    "finish/test_close.py",
    "height/test_mast3r.py",
    "workflow/test_learned.py",
    "workflow/test_added_methods.py",
)
"""Files of tests that begin first: those that compile most of what other files use, too, and those that take longest. One that begins
last has other processes wait for it."""


def pytest_configure() -> None:
    """As steps do."""
    keep_freed_memory()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {REPOSITORY / "tests" / name: place for place, name in enumerate(FIRST)}
    items.sort(key=lambda item: rank.get(item.path, len(rank)))


def pytest_collection_finish() -> None:
    """The modules of all tests stay until the end: garbage collections pass over them."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(specs) -> None:
    """Each process has compiled kernels of its own (shared_kernels.py says why)."""
    for spec in specs:
        spec.env["NUMBA_CACHE_DIR"] = str(KERNELS / spec.id)


@pytest.fixture(scope="module", autouse=True)
def kernels_of_all() -> None:
    """Before the tests of a file, take what the other processes have compiled since the last one."""
    from helpers.shared_kernels import take_kernels

    own = Path(os.environ.get("NUMBA_CACHE_DIR", REPOSITORY))
    if own.parent == KERNELS:
        take_kernels(KERNELS, own)


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
    """The raised ring of ten views (480 x 360) around a printed carton on a textured surface, with true cameras.

    One process of the test run makes it, and the others wait for it. Tests change only copies.
    """
    common = tmp_path_factory.getbasetemp()
    if os.environ.get("PYTEST_XDIST_WORKER"):
        common = common.parent
    with (common / "carton_capture.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (common / "carton_capture/ring/truth").is_dir():
            _capture_carton(common / "carton_capture")
    return common / "carton_capture/ring"


def _capture_carton(folder: Path) -> None:
    from helpers.coarse_ground import coarse_ground
    from zeroshop_steps.synthetic.demo_objects import write_demo_object
    from zeroshop_steps.synthetic.raycast import capture
    from zeroshop_steps.synthetic.scenes.camera_rings import Rings

    write_demo_object("gelatin_carton", folder / "model")
    with coarse_ground(2048):
        capture(folder / "model" / "model.ply", "su_h", 480, 360, 0, folder / "ring", rings=Rings(elevations_deg=(45.0,)))


@pytest.fixture(scope="session")
def blender() -> Path:
    """The record of BlenderProc's environment; tests that need it are skipped where it was not set up."""
    record = Path(os.environ.get("ZEROSHOP_BLENDERPROC") or REPOSITORY / "resources/envs/blenderproc.json")
    if not record.is_file():
        pytest.skip("BlenderProc is not set up (snakemake resources/envs/blenderproc.json), nor named in ZEROSHOP_BLENDERPROC")
    return record


@pytest.fixture
def few_rays(monkeypatch) -> None:
    """A third of the outlines' rays, where it is not asked how much they count beside tracks: a box has no rim that so few would miss."""
    from zeroshop_steps.register.silhouettes import rays

    monkeypatch.setattr(rays, "MOST_RAYS_OF_VIEW", 80)
