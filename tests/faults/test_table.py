"""Every planned fault ends in one clear message, a status that is not 0, no traceback, and nothing half-written."""

from pathlib import Path

import pytest

from faults import bags, cameras, captures, generation, heights, machine, models, photos, plans, poses, recognition, robots
from helpers.faults import CLEAR, Fault, judge

ROOMS = (bags, cameras, captures, generation, heights, machine, models, photos, plans, poses, recognition, robots)
QUICK = {generation: 9, plans: 4, recognition: 10}
"""How many of a part's faults every check runs, where each takes half a second and more."""


def slow_from(quick: int | None, index: int) -> list[pytest.MarkDecorator]:
    """The marks of a fault of a part."""
    return [] if quick is None or index < quick else [pytest.mark.slow]


TABLE = [
    pytest.param(fault, id=f"{room.__name__.rpartition('.')[2]}: {fault.name}", marks=slow_from(QUICK.get(room), index))
    for room in ROOMS
    for index, fault in enumerate(room.FAULTS)
]


@pytest.mark.parametrize("fault", TABLE)
def test_fault(fault: Fault, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert judge(fault, tmp_path, capfd) == CLEAR
