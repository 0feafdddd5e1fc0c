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
    message = r"^.*absent.ply does not exist, and .*mesh.ply is made from it; check the path"
    with pytest.raises(StepError, match=message), atomic_write(tmp_path / "mesh.ply"):
        (tmp_path / "absent.ply").read_bytes()


def start_slow_step(folder: Path) -> subprocess.Popen[str]:
    """A step that writes into the folder `made/out` until it is stopped; it has said so when this returns."""
    (folder / "stage").mkdir(exist_ok=True)
    (folder / "stage/__init__.py").touch()
    (folder / "stage/slow.py").write_text(
        "import time\n"
        "from pathlib import Path\n"
        "from zeroshop_steps.runtime.files import atomic_directory, atomic_write, scratch_directory\n"
        "def add_arguments(parser): pass\n"
        "def run(args):\n"
        f"    made = Path({str(folder / 'made')!r})\n"
        "    with atomic_directory(made / 'out') as folder, atomic_write(made / 'mesh.ply'), scratch_directory(made / 'out', 'colmap'):\n"
        "        (folder / 'half').touch()\n"
        "        print('writing', flush=True)\n"
        "        time.sleep(60)\n"
    )
    step = "import sys; from zeroshop_steps.runtime.cli import stage_main; sys.exit(stage_main('stage'))"
    command = [sys.executable, "-c", step, "--method", "slow"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)
    assert process.stdout and process.stdout.readline() == "writing\n"
    return process


def test_what_a_killed_step_left_is_removed_by_the_next_one(tmp_path: Path) -> None:
    killed, living = start_slow_step(tmp_path), None
    assert len(list((tmp_path / "made").iterdir())) == 3
    killed.kill()
    killed.communicate()
    assert len(list((tmp_path / "made").iterdir())) == 3, "nobody could clean up"
    living = start_slow_step(tmp_path)
    try:
        own = {path.name for path in (tmp_path / "made").iterdir()}
        assert len(own) == 3, "those of the killed step are gone"
        write_json(tmp_path / "made/out.json", {})
        with atomic_directory(tmp_path / "made/out") as folder:
            (folder / "whole").touch()
        assert own < {path.name for path in (tmp_path / "made").iterdir()}, "those of a living process stay"
    finally:
        living.terminate()
        living.communicate()
    assert sorted(path.name for path in (tmp_path / "made").iterdir()) == ["out", "out.json"]


def test_two_processes_may_write_the_same_folder(tmp_path: Path) -> None:
    """As where a step of a killed run still lives, and the next run makes the same."""
    write = (
        "from pathlib import Path\n"
        "from zeroshop_steps.runtime.files import atomic_directory\n"
        "for _ in range(150):\n"
        f"    with atomic_directory(Path({str(tmp_path / 'out')!r})) as folder:\n"
        "        (folder / 'one').write_text('x'); (folder / 'two').write_text('x')\n"
    )
    writers = [subprocess.Popen([sys.executable, "-c", write], stderr=subprocess.PIPE, text=True) for _ in range(2)]
    errors = [writer.communicate(timeout=120)[1] for writer in writers]
    assert [writer.returncode for writer in writers] == [0, 0], errors
    assert [path.name for path in tmp_path.iterdir()] == ["out"] and len(list((tmp_path / "out").iterdir())) == 2


def test_a_long_name(tmp_path: Path) -> None:
    write_json(tmp_path / ("n" * 250 + ".json"), {"a": 1})
    with pytest.raises(StepError, match="Use shorter names"):
        write_json(tmp_path / ("n" * 260 + ".json"), {})
    assert len(list(tmp_path.iterdir())) == 1


def test_a_request_to_end_leaves_nothing_half_written(tmp_path: Path) -> None:
    with start_slow_step(tmp_path) as process:
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
