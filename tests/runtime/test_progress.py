"""Progress in a log."""

import pytest

from zeroshop_steps.runtime import progress
from zeroshop_steps.runtime.progress import ProgressReport


@pytest.fixture
def clock(monkeypatch):
    """Seconds that stand still until they are set."""
    now = {"s": 0.0}
    monkeypatch.setattr(progress.time, "monotonic", lambda: now["s"])
    return now


def test_a_log_has_a_line_every_ten_seconds_and_one_at_the_end(clock, capsys):
    with ProgressReport("train", 100) as report:
        for second in range(1, 51):
            clock["s"] = second
            report.advance(2, "loss 1")
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in lines] == ["train: 20/100", "train: 40/100", "train: 60/100", "train: 80/100", "train: 100/100"]
    assert lines[0].endswith("40 s left loss 1")


def test_what_an_earlier_run_did_does_not_count_as_speed(clock, capsys):
    with ProgressReport("train", 100, done=50) as report:
        clock["s"] = 10
        report.advance(10)
    assert capsys.readouterr().err == "train: 60/100, 40 s left\n"
