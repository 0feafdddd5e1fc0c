"""A failure is recorded in a table run, passed on by the steps that follow, and ends any other run with its reason."""

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


def clean(folder: Path) -> int:
    """Run a step that fails, because its mesh does not exist, with two outputs."""
    words = ["--method", "clean", "--mesh", f"{folder}/none.ply", "--cameras", str(folder), "--out", f"{folder}/clean.ply"]
    return stage_main("zeroshop_steps.finish", [*words, "--record-failure", f"{folder}/clean.ply", f"{folder}/clean.json"])


def test_a_table_run_records_a_failure_in_place_of_every_output(tmp_path, monkeypatch):
    monkeypatch.setenv(failures.SWITCH, "1")
    assert clean(tmp_path) == 0
    records = [read_failure(tmp_path / name) for name in ("clean.ply", "clean.json")]
    assert records[0] == records[1]
    assert records[0].step == "finish.clean" and "none.ply does not exist" in records[0].reason


def test_any_other_run_fails_and_writes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv(failures.SWITCH, raising=False)
    assert clean(tmp_path) == 1
    assert "none.ply does not exist" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_record_is_passed_on_in_a_table_run_and_refused_in_any_other(tmp_path, monkeypatch, capsys):
    failure = Failure("surface.twodgs", "left 3 disks")
    write_failure([tmp_path / "part.ply"], failure)
    out = str(tmp_path / "outcome.json")
    monkeypatch.delenv(failures.SWITCH, raising=False)
    assert outcome(tmp_path, "--out", out, "--record-failure", out) == 1
    assert "left 3 disks" in capsys.readouterr().err and not Path(out).exists()
    monkeypatch.setenv(failures.SWITCH, "1")
    assert outcome(tmp_path, "--out", out) == 1, "a step that may not record ends with the reason"
    assert outcome(tmp_path, "--out", out, "--record-failure", out) == 0
    assert read_failure(Path(out)) == failure


def test_a_step_run_again_takes_no_notice_of_the_record_in_its_own_place(tmp_path, monkeypatch):
    monkeypatch.setenv(failures.SWITCH, "1")
    out = tmp_path / "outcome.json"
    write_failure([out], Failure("surface.twodgs", "left 3 disks"))
    (tmp_path / "part.ply").write_bytes(b"ply\n")
    assert outcome(tmp_path, "--out", str(out), "--record-failure", str(out)) == 0
    assert read_failure(out) is None


def test_a_whole_cell_has_no_failure(tmp_path, monkeypatch):
    monkeypatch.setenv(failures.SWITCH, "1")
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
    assert failures.is_result(StepError("the mug ran out of memory foam")), "a step's own words are judged by their cause alone"
    assert not failures.is_result(KeyboardInterrupt()) and not failures.is_result(torch.OutOfMemoryError("CUDA"))
    assert failures.reason_of(ValueError("\x1b[1;31modd\x1b[0;m\nvalue\n")) == "unexpected ValueError: odd value"
