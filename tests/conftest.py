"""Fixtures that several stages' tests share."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


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
    from carton_scene import photographed_carton

    return photographed_carton(tmp_path_factory.mktemp("carton"))


@pytest.fixture(scope="session")
def blender() -> Path:
    """The record of BlenderProc's environment; tests that need it are skipped where it was not set up."""
    record = Path(os.environ.get("ZEROSHOP_BLENDERPROC") or REPOSITORY / "resources/envs/blenderproc.json")
    if not record.is_file():
        pytest.skip("BlenderProc is not set up (snakemake resources/envs/blenderproc.json), nor named in ZEROSHOP_BLENDERPROC")
    return record
