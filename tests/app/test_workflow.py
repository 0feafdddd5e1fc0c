"""The progress that is read from Snakemake's report."""

import io
import os

import pytest

from zeroshop_steps.app.summary import find_reason, name_photos
from zeroshop_steps.app.workflow import Progress, _show
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json

REPORT = """\
Job stats:
job              count
-------------  -------
stereo               1
train_2dgs           1
weigh                2
total                4

Select jobs to execute...

[Sun Nov 22 19:45:22 2026]
Job 3: Looking for confirmed depths of cup
Reason: Missing output files
"""


def test_the_share_follows_what_jobs_usually_take():
    progress = Progress()
    for line in REPORT.splitlines(keepends=True):
        progress.read(line)
    assert progress.planned == {"stereo": 1, "train_2dgs": 1, "weigh": 2} and progress.share == 0.0
    assert progress.describe().endswith("Looking for confirmed depths of cup")
    progress.read("Finished jobid: 3 (Rule: stereo)\n")
    assert progress.share == pytest.approx(16 / (16 + 25 + 2 * 3)) and not progress.running
    for number, rule in enumerate(("train_2dgs", "weigh", "weigh")):
        progress.read(f"Finished jobid: {number} (Rule: {rule})\n")
    assert progress.share == 1.0


def test_a_step_that_failed_is_said_at_once_and_no_later_stage_seems_to_run(tmp_path, capsys):
    cameras = tmp_path / "video/auto/scene"
    write_failure([f"{tmp_path / 'old'}/"], Failure("register.colmap", "an earlier run"))
    os.utime(tmp_path / "old/failure.json", (0, 0))

    def report():
        yield from REPORT.splitlines(keepends=True)
        write_failure([f"{cameras}/"], Failure("register.auto", "only 3 of 12 images registered"))
        yield "Finished jobid: 3 (Rule: stereo)\n"
        yield "Job 4: Training 2dgs on cup\n"

    _show(Progress(), report(), io.StringIO(), tmp_path)
    shown = capsys.readouterr().err
    assert "register.auto failed; the steps after it only note that" in shown and "Training" not in shown and shown.count("failed") == 1


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        ("x\nerror: too dark\nerror: too dark\ny\n", ["too dark"]),
        ("LockException:\nDirectory cannot be locked.\n", ["another run works in this folder"]),
        ("a\nWorkflowError:\nunknown nvs method: nerf\n", ["WorkflowError:", "unknown nvs method: nerf"]),
    ],
)
def test_the_reason_of_a_failure_is_found(tmp_path, log, reason):
    (tmp_path / "log").write_text(log)
    found = find_reason(tmp_path / "log")
    assert len(found) == len(reason) and all(line.startswith(start) for line, start in zip(found, reason, strict=True))


def test_photos_go_by_the_users_names(tmp_path):
    said = "too bright in 000001.png, 000007.png"
    assert name_photos(said, tmp_path) == said
    write_json(tmp_path / "video/capture/capture.json", {"source_names": ["IMG_7.jpg", "IMG_9.heic"]})
    assert name_photos(said, tmp_path) == "too bright in IMG_9.heic, 000007.png"
