"""The progress that is told by Snakemake's events."""

import json
import os
import subprocess
import sys

import pytest

from snakemake_logger_plugin_zeroshop import EVENTS_FD
from zeroshop_steps.app.summary import find_reason, name_photos
from zeroshop_steps.app.workflow import Progress, _show
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json

EVENTS = [
    {"planned": {"stereo": 1, "train_2dgs": 1, "weigh": 2}},
    {"job": 3, "rule": "stereo", "says": "Looking for confirmed depths of cup"},
]


def test_the_share_follows_what_jobs_usually_take():
    progress = Progress()
    for event in EVENTS:
        progress.read(event)
    assert progress.planned == {"stereo": 1, "train_2dgs": 1, "weigh": 2} and progress.share == 0.0
    assert progress.describe().endswith("Looking for confirmed depths of cup")
    progress.read({"finished": 3})
    assert progress.share == pytest.approx(16 / (16 + 25 + 2 * 3)) and not progress.running
    for number, rule in enumerate(("train_2dgs", "weigh", "weigh")):
        progress.read({"job": number, "rule": rule, "says": ""})
        progress.read({"finished": number})
    assert progress.share == 1.0


def test_a_step_that_failed_is_said_at_once_and_no_later_stage_seems_to_run(tmp_path, capsys):
    cameras = tmp_path / "video/auto/scene"
    write_failure([f"{tmp_path / 'old'}/"], Failure("register.colmap", "an earlier run"))
    os.utime(tmp_path / "old/failure.json", (0, 0))

    def events():
        yield from EVENTS
        write_failure([f"{cameras}/"], Failure("register.auto", "only 3 of 12 images registered"))
        yield {"finished": 3}
        yield {"job": 4, "rule": "train_2dgs", "says": "Training 2dgs on cup"}

    _show(Progress(), events(), tmp_path)
    shown = capsys.readouterr().err
    assert "register.auto failed; the steps after it only note that" in shown and "Training" not in shown and shown.count("failed") == 1


def test_snakemake_finds_the_plugin_and_says_what_it_plans_and_does(tmp_path):
    (tmp_path / "Snakefile").write_text(
        'rule bake:\n    output: "cake"\n    message: "Baking {output}"\n    shell: "touch {output}"\n'
        'rule eat:\n    input: "cake"\n    output: "crumbs"\n    shell: "touch {output}"\n'
    )
    events, writable = os.pipe()
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--logger", "zeroshop", "--", "crumbs"]
    run = subprocess.run(
        command, cwd=tmp_path, pass_fds=[writable], env={**os.environ, EVENTS_FD: str(writable)}, capture_output=True, text=True
    )
    os.close(writable)
    assert run.returncode == 0 and "Baking cake" in run.stderr, "Snakemake's own report stays"
    with open(events) as lines:
        planned, bake, baked, eat, eaten = map(json.loads, lines)
    assert planned == {"planned": {"bake": 1, "eat": 1}}
    assert (bake["rule"], bake["says"]) == ("bake", "Baking cake") and baked == {"finished": bake["job"]}
    assert (eat["rule"], eat["says"]) == ("eat", "") and eaten == {"finished": eat["job"]}


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        ("x\nerror: too dark\nerror: too dark\ny\n", ["too dark"]),
        (
            "LockException:\nDirectory cannot be locked.\n",
            ["another run works in /"],
        ),
        ("InputFunctionException in rule x:\nError:\n  StepError: a ü holds braces\nWildcards:\n", ["a ü holds braces"]),
        ("a\nWorkflowError:\nunknown nvs method: nerf\n", ["WorkflowError:", "unknown nvs method: nerf"]),
    ],
)
def test_the_reason_of_a_failure_is_found(tmp_path, log, reason):
    (tmp_path / "log").write_text(log)
    found = find_reason(tmp_path / "log")
    assert len(found) == len(reason) and all(line.startswith(start) for line, start in zip(found, reason, strict=True))


def test_who_holds_a_lock_is_told(tmp_path):
    (tmp_path / "log").write_text(f"LockException:\nthe same files in the following directory:\n{tmp_path}\nIf you are sure, unlock it")
    assert find_reason(tmp_path / "log") == [
        f"another run works in {tmp_path}; wait for it, or, if none does, delete {tmp_path / '.snakemake/locks'}"
    ]
    write_json(tmp_path / ".snakemake/zeroshop_run.json", {"machine": "lab3", "process": 4711, "began_s": 1.0})
    assert f"works in {tmp_path}, by its note process 4711 of the machine lab3; wait" in find_reason(tmp_path / "log")[0]


def test_photos_go_by_the_users_names(tmp_path):
    said = "too bright in 000001.png, 000007.png"
    assert name_photos(said, tmp_path) == said
    write_json(tmp_path / "video/capture/capture.json", {"source_names": ["IMG_7.jpg", "IMG_9.heic"]})
    assert name_photos(said, tmp_path) == "too bright in IMG_9.heic, 000007.png"
