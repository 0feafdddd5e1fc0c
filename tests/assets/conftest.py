"""Bodies that several tests read: made once."""

from pathlib import Path

import pytest

from helpers.small_bodies import make_box, make_cylinder, make_formats


@pytest.fixture(scope="session")
def box_folder(tmp_path_factory) -> Path:
    return make_formats(tmp_path_factory.mktemp("box"), make_box())


@pytest.fixture(scope="session")
def cylinder_folder(tmp_path_factory) -> Path:
    return make_formats(tmp_path_factory.mktemp("cylinder"), make_cylinder())
