"""What the tests of the pose stage share."""

import shutil
from types import SimpleNamespace

import pytest

from helpers.painted_scene import write_painted_dataset


@pytest.fixture(scope="session")
def painted_once(tmp_path_factory) -> SimpleNamespace:
    """The painted dataset; not to be changed."""
    return write_painted_dataset(tmp_path_factory.mktemp("painted"))


@pytest.fixture
def dataset(painted_once, tmp_path) -> SimpleNamespace:
    """A copy of it of this test's own."""
    shutil.copytree(painted_once.folder, tmp_path / "data")
    folder = tmp_path / "data"
    return SimpleNamespace(folder=folder, scenes=folder / "test", scene=folder / "test" / "000001", frames=painted_once.frames)
