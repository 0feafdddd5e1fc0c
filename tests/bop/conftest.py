"""What the tests of the BOP stage share."""

from types import SimpleNamespace

import pytest

from helpers.small_dataset import make_dataset


@pytest.fixture
def dataset(tmp_path) -> SimpleNamespace:
    """A dataset of this test's own."""
    return make_dataset(tmp_path / "data")
