"""Fixtures of the capture tests."""

from pathlib import Path

import pytest
from capture_box import write_box


@pytest.fixture(scope="session")
def box(tmp_path_factory) -> Path:
    """Path of the box's PLY."""
    return write_box(tmp_path_factory.mktemp("box"))
