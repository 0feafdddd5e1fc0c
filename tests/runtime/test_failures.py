"""A failure is recorded where the outputs may be records, passed on by the steps that follow, and ends any other step with its reason."""

import json
import sys
from pathlib import Path

import pytest
import torch

from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.runtime import failures
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, read_failure, write_failure
from zeroshop_steps.runtime.files import read_json, write_json


def link(folder: Path, out: Path | str, *more: str, file: str = "part.ply") -> int:
    """Run a light step on one file."""
    return stage_main("zeroshop_steps.finish", ["--method", "link_mesh", "--files", f"{folder}/{file}", "--links", str(out), *more])


def texture(folder: Path, *more: str) -> int:
    """Run a step that fails, because its frame does not exist."""
    words = ["--mesh", f"{folder}/none.ply", "--frame", f"{folder}/none.json", "--cameras", str(folder), "--out", f"{folder}/mesh.ply"]
    return stage_main("zeroshop_steps.finish", ["--method", "texture", *words, *more])


def test_a_failure_is_recorded_in_place_of_every_output(tmp_path, capsys):
    assert texture(tmp_path, "--record-failure", f"{tmp_path}/mesh.ply", f"{tmp_path}/mesh.json") == 0
    records = [read_failure(tmp_path / name) for name in ("mesh.ply", "mesh.json")]
    assert records[0] == records[1]
    assert records[0].step == "finish.texture" and "none.json does not exist" in records[0].reason
    assert records[0].place == records[1].place == f"{tmp_path}/mesh.ply"
    assert f"failed, recorded in {tmp_path}/mesh.ply: finish.texture: " in capsys.readouterr().err


def test_a_step_that_may_not_record_fails_and_writes_nothing(tmp_path, capsys):
    assert texture(tmp_path) == 1
    assert "none.json does not exist" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_a_step_had_written_before_it_failed_stays(tmp_path, carton):
    """The mesh is cleaned, which a table of heights reads; without a known height, the height fails, and what comes after it."""
    write_ply(tmp_path / "raw_mesh.ply", carton.mesh)
    write_json(tmp_path / "capture/capture.json", {})
    files = {"mesh": tmp_path / "raw_mesh.ply", "cameras": carton.cameras, "capture": tmp_path / "capture", "out": tmp_path / "closed.ply"}
    outputs = [tmp_path / name for name in ("clean.ply", "clean.json", "height.json", "closed.ply", "closed.json", "frame.json")]
    for output in outputs:
        write_failure([output], Failure("finish.clean", "of an earlier run"))
    words = [word for name, path in files.items() for word in (f"--{name}", path)]
    words = ["--method", "shape", *words, "--record-failure", *outputs, "--height", "known"]
    assert stage_main("zeroshop_steps.finish", [str(word) for word in words]) == 0
    assert len(read_ply(outputs[0]).faces) > 100 and read_json(outputs[1])["faces"] > 100
    left = [read_failure(path) for path in outputs[2:]]
    assert all(failure.step == "height.known" and "no height is given" in failure.reason for failure in left)


def test_a_record_is_passed_on_and_ends_a_step_that_may_not_record(tmp_path, capsys):
    failure = Failure("surface.twodgs", "left 3 disks")
    write_failure([f"{tmp_path}/part.ply"], failure)
    out = str(tmp_path / "link.ply")
    assert link(tmp_path, out) == 1
    error = capsys.readouterr().err
    assert "left 3 disks" in error and not Path(out).exists()
    assert f"delete {tmp_path}/part.ply or call snakemake with --forcerun {tmp_path}/part.ply" in error
    assert link(tmp_path, out, "--record-failure", out) == 0
    assert read_failure(Path(out)) == failure
    assert read_failure(Path(out)).place == f"{tmp_path}/part.ply", "where it was first recorded"


def test_a_record_is_passed_on_before_the_method_is_imported(tmp_path, monkeypatch):
    """Of a failed cell, the imports would take nearly all of the time."""
    monkeypatch.delitem(sys.modules, "zeroshop_steps.finish.texture", raising=False)
    write_failure([f"{tmp_path}/none.ply"], Failure("surface.twodgs", "left 3 disks"))
    assert texture(tmp_path, "--record-failure", f"{tmp_path}/mesh.png") == 0
    assert read_failure(tmp_path / "mesh.png").reason == "left 3 disks" and "zeroshop_steps.finish.texture" not in sys.modules


def test_a_folder_holds_its_record_and_the_details_of_the_failure(tmp_path):
    def write_details(folder):
        (folder / "seen.txt").write_text("3 disks")

    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras/old.txt").touch()
    failure = write_failure([f"{tmp_path}/cameras/"], Failure("register.colmap", "no matches"), write_details)
    assert read_failure(tmp_path / "cameras") == failure and failure.place == str(tmp_path / "cameras")
    assert sorted(path.name for path in (tmp_path / "cameras").iterdir()) == ["failure.json", "seen.txt"]
    assert link(tmp_path, tmp_path / "link", "--record-failure", f"{tmp_path}/link", file="cameras") == 0
    assert read_failure(tmp_path / "link") == failure


def test_a_record_of_an_earlier_version_has_the_place_where_it_lies(tmp_path):
    (tmp_path / "clean.ply").write_text(json.dumps({"failed": "surface.fuse", "reason": "no surface"}) + "\n")
    assert read_failure(tmp_path / "clean.ply").place == f"{tmp_path}/clean.ply"


def test_a_step_run_again_takes_no_notice_of_the_record_in_its_own_place(tmp_path):
    out = tmp_path / "link.ply"
    write_failure([str(out)], Failure("surface.twodgs", "left 3 disks"))
    (tmp_path / "part.ply").write_bytes(b"ply\n")
    assert link(tmp_path, out, "--record-failure", str(out)) == 0
    assert read_failure(out) is None and out.read_bytes() == b"ply\n"


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
