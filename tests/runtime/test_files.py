"""Whole files or none: what a failed or interrupted write leaves behind."""

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, atomic_write, read_json, write_json


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "product.json"
    write_json(target, {"a": 1})
    with pytest.raises(ValueError, match="boom"), atomic_write(target) as temporary:
        temporary.write_text("half")
        raise ValueError("boom")
    assert read_json(target) == {"a": 1} and [path.name for path in tmp_path.iterdir()] == ["product.json"]


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(StepError, match=r"mesh.ply: No space left on device. Check free disk space"), atomic_write(tmp_path / "mesh.ply"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(StepError, match="No space left"), atomic_directory(tmp_path / "folder") as folder:
        (folder / "image.png").write_bytes(b"x")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_could_not_be_read_is_named(tmp_path: Path) -> None:
    message = r"cannot write .*mesh.ply: No such file or directory: .*absent.ply"
    with pytest.raises(StepError, match=message), atomic_write(tmp_path / "mesh.ply"):
        (tmp_path / "absent.ply").read_bytes()


def test_a_request_to_end_leaves_nothing_half_written(tmp_path: Path) -> None:
    (tmp_path / "stage").mkdir()
    (tmp_path / "stage/__init__.py").touch()
    (tmp_path / "stage/slow.py").write_text(
        "import time\n"
        "from pathlib import Path\n"
        "from zeroshop_steps.runtime.files import atomic_directory\n"
        "def add_arguments(parser): pass\n"
        "def run(args):\n"
        f"    with atomic_directory(Path({str(tmp_path / 'made/out')!r})) as folder:\n"
        "        (folder / 'half').touch()\n"
        "        print('writing', flush=True)\n"
        "        time.sleep(60)\n"
    )
    step = "import sys; from zeroshop_steps.runtime.cli import stage_main; sys.exit(stage_main('stage'))"
    command = [sys.executable, "-c", step, "--method", "slow"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout.readline() == "writing\n"
        process.terminate()
        assert "interrupted" in process.communicate()[1]
    assert process.returncode == 130 and list((tmp_path / "made").iterdir()) == []


def test_a_folder_is_replaced_whole(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "stale").touch()
    with atomic_directory(tmp_path / "out") as folder:
        (folder / "fresh").touch()
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["fresh"]


def test_damaged_json_is_named(tmp_path: Path) -> None:
    (tmp_path / "frame.json").write_text('{"a": ')
    with pytest.raises(StepError, match="frame.json is not valid JSON"):
        read_json(tmp_path / "frame.json")
    with pytest.raises(StepError, match="absent.json does not exist"):
        read_json(tmp_path / "absent.json")
