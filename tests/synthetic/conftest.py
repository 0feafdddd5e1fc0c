"""What the tests of virtual captures share."""

from pathlib import Path

import pytest

from helpers.capture_box import write_box


@pytest.fixture(scope="session")
def box(tmp_path_factory) -> Path:
    """Path of the box's PLY."""
    return write_box(tmp_path_factory.mktemp("box"))
