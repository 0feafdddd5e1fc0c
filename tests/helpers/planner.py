"""A process in which Snakemake is imported once, for the many tests that only ask what would run: half of such a call is imports.

Each call is a fork of that process, which has read nothing else; so calls share no state.
"""

import atexit
import contextlib
import functools
import importlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

USED_BY_EVERY_PLAN = ("jinja2", "jsonschema", "requests", "rich.progress", "smart_open")
"""What Snakemake imports late. Nothing of the project is imported: a test may bring its own copy of that."""


@functools.cache
def _server() -> subprocess.Popen[str]:
    server = subprocess.Popen([sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True)
    atexit.register(server.kill)
    return server


def _stop(server: subprocess.Popen[str]) -> None:
    """End the process with the call that it is in; the next call gets another one."""
    _server.cache_clear()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(server.pid, signal.SIGKILL)
    server.wait()


def call_snakemake(folder: Path, arguments: list[str], environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Call Snakemake in `folder` with exactly this environment; stdout and stderr come back together in `stdout`."""
    server, said = _server(), folder / ".said"
    assert server.stdin and server.stdout
    try:
        server.stdin.write(json.dumps([str(folder), arguments, environment, str(said)]) + "\n")
        server.stdin.flush()
        status = int(server.stdout.readline())
    except BaseException:  # a test that took too long, above all: the next one must not read its answer
        _stop(server)
        raise
    output = said.read_text()
    said.unlink()
    return subprocess.CompletedProcess(arguments, status, output)


def _serve() -> None:
    for name in USED_BY_EVERY_PLAN:
        importlib.import_module(name)
    from snakemake.cli import get_argument_parser, main

    get_argument_parser()  # looks for Snakemake's plugins and imports them
    for line in sys.stdin:
        folder, arguments, environment, said = json.loads(line)
        child = os.fork()
        if child == 0:
            os.chdir(folder)
            os.environ.clear()
            os.environ.update(environment)
            nothing = os.open(os.devnull, os.O_RDONLY)
            words = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for ours, theirs in ((nothing, 0), (words, 1), (words, 2)):
                os.dup2(ours, theirs)
            sys.argv = ["snakemake", *arguments]
            sys.path[0] = folder  # as `python -m snakemake` has it
            sys.exit(main(arguments))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    _serve()
