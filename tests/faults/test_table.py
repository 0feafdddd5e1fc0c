"""Every planned fault ends in one clear message, a status that is not 0, no traceback, and nothing half-written."""

from pathlib import Path

import pytest

from faults import cameras, machine, models, photos, plans, poses
from helpers.faults import CLEAR, Fault, judge

ROOMS = (cameras, machine, models, photos, plans, poses)
TABLE = [(room.__name__.rpartition(".")[2], fault) for room in ROOMS for fault in room.FAULTS]


@pytest.mark.parametrize("fault", [pytest.param(fault, id=f"{room}: {fault.name}") for room, fault in TABLE])
def test_fault(fault: Fault, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert judge(fault, tmp_path, capfd) == CLEAR
