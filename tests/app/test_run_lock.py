"""A lock that a dead run left behind is freed; that of a run that lives, or of another machine, is not."""

import os
import platform
import signal
import subprocess
import sys
import time

import pytest

from snakemake_logger_plugin_zeroshop import EVENTS_FD
from zeroshop_steps.app.run_lock import LOCKS, NOTE, free_dead_lock, note_run, remove_note
from zeroshop_steps.runtime.files import read_json, write_json


@pytest.fixture
def locked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def hold(folder, process):
    """Note a process, which then takes the lock."""
    note_run(folder, process)
    (folder / LOCKS).mkdir(parents=True)
    (folder / LOCKS / "0.lock").write_text("results/cup")


def make_dead_process():
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        pass
    return process.pid


def test_the_lock_of_a_dead_run_is_freed(locked):
    hold(locked, make_dead_process())
    assert free_dead_lock(locked)
    assert not (locked / LOCKS).exists() and not free_dead_lock(locked)


def test_the_lock_of_a_run_that_lives_stays(locked):
    hold(locked, os.getpid())
    assert not free_dead_lock(locked) and list((locked / LOCKS).iterdir())


def test_the_lock_of_another_machine_stays(locked, monkeypatch):
    hold(locked, make_dead_process())
    write_json(locked / NOTE, read_json(locked / NOTE) | {"machine": "elsewhere"})
    assert not free_dead_lock(locked) and list((locked / LOCKS).iterdir())


def test_a_lock_without_a_note_stays(locked):
    hold(locked, make_dead_process())
    (locked / NOTE).unlink()
    assert not free_dead_lock(locked)


def test_another_process_that_got_the_number_does_not_hold_the_lock(locked):
    hold(locked, os.getpid())
    write_json(locked / NOTE, read_json(locked / NOTE) | {"began_s": 1000.0})
    assert free_dead_lock(locked)


def test_a_note_of_an_earlier_version_is_read(locked):
    hold(locked, os.getpid())
    write_json(locked / NOTE, {"machine": platform.node(), "process": os.getpid()})
    assert not free_dead_lock(locked)
    write_json(locked / NOTE, {"machine": platform.node(), "process": make_dead_process()})
    assert free_dead_lock(locked)


def test_the_lock_of_a_snakemake_that_the_user_called_stays(locked):
    """It leaves no note; that of a run before it is still there."""
    hold(locked, make_dead_process())
    program = locked / "snakemake"
    program.write_text("print(flush=True)\ninput()")
    with subprocess.Popen([sys.executable, program], cwd=locked, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline()
        assert not free_dead_lock(locked) and list((locked / LOCKS).iterdir())
        process.communicate(b"\n")
    assert free_dead_lock(locked)


def test_a_run_that_ended_holds_no_later_lock(locked):
    dead = make_dead_process()
    hold(locked, dead)
    remove_note(locked, dead)
    assert not free_dead_lock(locked)


def test_a_run_that_finds_the_folder_locked_leaves_the_note_of_the_other(locked):
    hold(locked, os.getpid())
    second = make_dead_process()
    note_run(locked, second)
    remove_note(locked, second)
    assert read_json(locked / NOTE)["process"] == os.getpid()


def test_snakemake_goes_on_where_it_was_killed(locked):
    (locked / "Snakefile").write_text(
        'rule slow:\n    output: "slow"\n    shell: "sleep 60"\nrule quick:\n    output: "quick"\n    shell: "touch quick"'
    )
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--logger", "zeroshop", "--"]
    environment = {**os.environ, EVENTS_FD: str(os.open(os.devnull, os.O_WRONLY))}
    with subprocess.Popen([*command, "slow"], start_new_session=True, env=environment, pass_fds=[int(environment[EVENTS_FD])]) as process:
        note_run(locked, process.pid)
        until_s = time.monotonic() + 60
        while not list(locked.glob(f"{LOCKS}/*.lock")) and time.monotonic() < until_s:
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGKILL)
    assert free_dead_lock(locked)
    assert not subprocess.call([*command, "quick"], env=environment, pass_fds=[int(environment[EVENTS_FD])])
    os.close(int(environment[EVENTS_FD]))
