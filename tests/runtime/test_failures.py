"""A failure is recorded where the outputs may be records, passed on by the steps that follow, and ends any other step with its reason."""

import json
import sys
from pathlib import Path

import pytest
import torch

from zeroshop_steps.runtime import failures
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, read_failure, write_failure


def outcome(folder: Path, *more: str) -> int:
    """Run a light step on one part of a mesh."""
    return stage_main("zeroshop_steps.evaluate", ["--method", "outcome", "--parts", f"{folder}/part.ply", *more])


def clean(folder: Path, *more: str) -> int:
    """Run a step that fails, because its mesh does not exist."""
    words = ["--method", "clean", "--mesh", f"{folder}/none.ply", "--cameras", str(folder), "--out", f"{folder}/clean.ply"]
    return stage_main("zeroshop_steps.finish", [*words, *more])


def test_a_failure_is_recorded_in_place_of_every_output(tmp_path, capsys):
    assert clean(tmp_path, "--record-failure", f"{tmp_path}/clean.ply", f"{tmp_path}/clean.json") == 0
    records = [read_failure(tmp_path / name) for name in ("clean.ply", "clean.json")]
    assert records[0] == records[1]
    assert records[0].step == "finish.clean" and "none.ply does not exist" in records[0].reason
    assert records[0].place == records[1].place == f"{tmp_path}/clean.ply"
    assert f"failed, recorded in {tmp_path}/clean.ply: finish.clean: " in capsys.readouterr().err


def test_a_step_that_may_not_record_fails_and_writes_nothing(tmp_path, capsys):
    assert clean(tmp_path) == 1
    assert "none.ply does not exist" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_record_is_passed_on_and_ends_a_step_that_may_not_record(tmp_path, capsys):
    failure = Failure("surface.twodgs", "left 3 disks")
    write_failure([f"{tmp_path}/part.ply"], failure)
    out = str(tmp_path / "outcome.json")
    assert outcome(tmp_path, "--out", out) == 1
    error = capsys.readouterr().err
    assert "left 3 disks" in error and not Path(out).exists()
    assert f"delete {tmp_path}/part.ply or call snakemake with --forcerun {tmp_path}/part.ply" in error
    assert outcome(tmp_path, "--out", out, "--record-failure", out) == 0
    assert read_failure(Path(out)) == failure
    assert read_failure(Path(out)).place == f"{tmp_path}/part.ply", "where it was first recorded"


def test_a_record_is_passed_on_before_the_method_is_imported(tmp_path, monkeypatch):
    """Of a failed cell, the imports would take nearly all of the time."""
    monkeypatch.delitem(sys.modules, "zeroshop_steps.finish.texture", raising=False)
    write_failure([f"{tmp_path}/unwrapped.ply"], Failure("surface.twodgs", "left 3 disks"))
    words = ["--method", "texture", "--mesh", f"{tmp_path}/unwrapped.ply", "--record-failure", f"{tmp_path}/texture.png"]
    assert stage_main("zeroshop_steps.finish", words) == 0
    assert read_failure(tmp_path / "texture.png").reason == "left 3 disks" and "zeroshop_steps.finish.texture" not in sys.modules


def test_a_folder_holds_its_record_and_the_details_of_the_failure(tmp_path):
    def write_details(folder):
        (folder / "seen.txt").write_text("3 disks")

    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras/old.txt").touch()
    failure = write_failure([f"{tmp_path}/cameras/"], Failure("register.colmap", "no matches"), write_details)
    assert read_failure(tmp_path / "cameras") == failure and failure.place == str(tmp_path / "cameras")
    assert sorted(path.name for path in (tmp_path / "cameras").iterdir()) == ["failure.json", "seen.txt"]
    assert outcome(tmp_path, f"{tmp_path}/cameras", "--out", f"{tmp_path}/out.json", "--record-failure", f"{tmp_path}/out.json") == 0
    assert read_failure(tmp_path / "out.json") == failure


def test_a_record_of_an_earlier_version_has_the_place_where_it_lies(tmp_path):
    (tmp_path / "clean.ply").write_text(json.dumps({"failed": "surface.fuse", "reason": "no surface"}) + "\n")
    assert read_failure(tmp_path / "clean.ply").place == f"{tmp_path}/clean.ply"


def test_a_step_run_again_takes_no_notice_of_the_record_in_its_own_place(tmp_path):
    out = tmp_path / "outcome.json"
    write_failure([str(out)], Failure("surface.twodgs", "left 3 disks"))
    (tmp_path / "part.ply").write_bytes(b"ply\n")
    assert outcome(tmp_path, "--out", str(out), "--record-failure", str(out)) == 0
    assert read_failure(out) is None


def test_a_whole_cell_has_no_failure(tmp_path):
    (tmp_path / "part.ply").write_bytes(b"ply\n")
    assert outcome(tmp_path, "--out", f"{tmp_path}/outcome.json", "--record-failure", f"{tmp_path}/outcome.json") == 0
    assert read_failure(tmp_path / "outcome.json") is None
    assert (tmp_path / "outcome.json").read_text() == '{\n  "failed": null\n}\n'


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\n", b'{"failed": "cut off', b'{"failed": "a"}'])
def test_other_files_are_no_records(tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    assert read_failure(tmp_path / "file") is None
    assert read_failure(tmp_path) is None and read_failure(tmp_path / "absent") is None


def test_what_the_machine_did_wrong_is_no_result():
    def raised(error: Exception, cause: Exception | None = None) -> Exception:
        error.__cause__ = cause
        return error

    assert failures.is_result(StepError("no surface")) and failures.is_result(ValueError("odd"))
    assert not failures.is_result(MemoryError()) and not failures.is_result(OSError(28, "no space left"))
    assert not failures.is_result(raised(StepError("cannot write"), OSError(28, "no space left")))
    no_memory = RuntimeError("[enforce fail at alloc_cpu.cpp:127] DefaultCPUAllocator: can't allocate memory: you tried to allocate 8 TB")
    assert not failures.is_result(no_memory) and not failures.is_result(ImportError("libusb"))
    for words in ("(-4:Insufficient memory) Failed to allocate 800 bytes", "CUDA error: device-side assert", "can't start new thread"):
        assert not failures.is_result(RuntimeError(words))
    refused = raised(StepError("the network takes 77 GB"), MemoryError())
    assert failures.is_result(refused, refusals=True) and not failures.is_result(refused)
    assert not failures.is_result(MemoryError(), refusals=True)
    assert not failures.is_result(raised(StepError("cannot write"), OSError(28, "no space left")), refusals=True)
    assert failures.is_result(StepError("the mug ran out of memory foam")), "a step's own words are judged by their cause alone"
    assert not failures.is_result(KeyboardInterrupt()) and not failures.is_result(torch.OutOfMemoryError("CUDA"))
    assert failures.reason_of(ValueError("\x1b[1;31modd\x1b[0;m\nvalue\n")) == "unexpected ValueError: odd value"
