"""A process in which Snakemake is imported once, for the many tests that call it: half of a call that only plans is imports.

Each call is a fork of that process, which has read nothing else; so calls share no state.
"""

import atexit
import contextlib
import functools
import gc
import hashlib
import importlib
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from helpers.forks import run_and_end
from helpers.paths import REPOSITORY
from helpers.warm_steps import warm_python

TESTS = REPOSITORY / "tests"
USED_BY_EVERY_PLAN = ("jinja2", "jsonschema", "requests", "rich.progress", "smart_open")
"""What Snakemake imports late. Nothing of the project is imported: a test may bring its own copy of that."""


@functools.cache
def _parsed_rules() -> tempfile.TemporaryDirectory[str]:
    """A folder that goes when this process ends."""
    return tempfile.TemporaryDirectory(prefix="parsed-rules-")


@functools.cache
def _server() -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "helpers.planner", _parsed_rules().name]
    server = subprocess.Popen(command, cwd=TESTS, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True)
    atexit.register(_end, server)
    return server


def _end(server: subprocess.Popen[str]) -> None:
    """End the process and wait for it, so that the time that it took counts as time of the tests."""
    server.kill()
    server.wait()


def _stop(server: subprocess.Popen[str]) -> None:
    """End the process with the call that it is in; the next call gets another one."""
    _server.cache_clear()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(server.pid, signal.SIGKILL)
    server.wait()


def call_snakemake(folder: Path, arguments: list[str], environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Call Snakemake in `folder` with exactly this environment; stdout and stderr come back together in `stdout`.

    Steps are run by `warm_python`.
    """
    server, said = _server(), folder / ".said"
    python = sys.executable if {"-n", "--unlock"} & set(arguments) else str(warm_python())
    assert server.stdin and server.stdout
    try:
        server.stdin.write(json.dumps([str(folder), arguments, environment, str(said), python]) + "\n")
        server.stdin.flush()
        status = int(server.stdout.readline())
    except BaseException:  # a test that took too long, above all: the next one must not read its answer
        _stop(server)
        raise
    output = said.read_text()
    said.unlink()
    return subprocess.CompletedProcess(arguments, status, output)


def _serve(parsed_rules: Path) -> None:
    for name in USED_BY_EVERY_PLAN:
        importlib.import_module(name)
    from snakemake.cli import get_argument_parser, main

    get_argument_parser()  # looks for Snakemake's plugins and imports them
    own = {str(TESTS), *os.environ.get("PYTHONPATH", "").split(os.pathsep)}
    installed = [place for place in sys.path if place not in own]
    _parse_once(parsed_rules)
    gc.freeze()  # a call's collections pass over what is imported here, a million objects: they took two fifths of a plan
    for line in sys.stdin:
        folder, arguments, environment, said, python = json.loads(line)
        child = os.fork()
        if child == 0:
            os.chdir(folder)
            os.environ.clear()
            os.environ.update(environment)
            nothing = os.open(os.devnull, os.O_RDONLY)
            words = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for ours, theirs in ((nothing, 0), (words, 1), (words, 2)):
                os.dup2(ours, theirs)
            sys.argv, sys.executable = ["snakemake", *arguments], python
            # As `python -m snakemake` has it, with the caller's sources.
            sys.path[:] = [folder, *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep)), *installed]
            run_and_end(functools.partial(main, arguments))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def _parse_once(kept: Path) -> None:
    """Let Snakemake take from a folder what an earlier call made of the same rules: of most plans, a third is parsing."""
    from snakemake import workflow

    parse = workflow.parse

    def parse_or_take(path, flow, linemap, overwrite_shellcmd=None, rulecount=0):
        where = path.get_path_or_uri(secret_free=True)
        asked = repr((where, Path(where).read_text(), overwrite_shellcmd, rulecount))
        place = kept / hashlib.sha256(asked.encode()).hexdigest()
        if not place.exists():
            made = parse(path, flow, linemap, overwrite_shellcmd, rulecount)
            part = place.with_suffix(f".{os.getpid()}")
            part.write_bytes(pickle.dumps((made, linemap)))
            part.replace(place)
            return made
        made, lines = pickle.loads(place.read_bytes())
        linemap |= lines
        return made

    workflow.parse = parse_or_take


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
