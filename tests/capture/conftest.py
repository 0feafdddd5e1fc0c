from pathlib import Path

import pytest

from helpers.shoot import Shoot


@pytest.fixture
def shoot(tmp_path: Path) -> Shoot:
    return Shoot(tmp_path, 9)
