"""Every planned fault ends in one clear message, a status that is not 0, no traceback, and nothing half-written."""

from pathlib import Path

import pytest

from faults import cameras, models, photos, poses
from helpers.faults import CLEAR, Fault, judge

TABLE = [(module.__name__.rpartition(".")[2], fault) for module in (cameras, models, photos, poses) for fault in module.FAULTS]


@pytest.mark.parametrize("fault", [pytest.param(fault, id=f"{room}: {fault.name}") for room, fault in TABLE])
def test_fault(fault: Fault, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert judge(fault, tmp_path, capfd) == CLEAR
