"""A process in which the packages of the steps are imported once: of the steps of a small workflow, most of the time is imports.

`warm_python` gives a Python for Snakemake to run steps with. A step becomes a fork of that process, which has run nothing else, with the
words, the environment, the folder and the outputs of the call; so calls share no state. What is no step it leaves to the real Python.
"""

import atexit
import contextlib
import functools
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

from helpers.forks import run_and_end
from helpers.paths import REPOSITORY

TESTS = REPOSITORY / "tests"
PACKAGES = (
    *("cv2", "matplotlib", "numba", "pandas", "pycolmap", "scipy.ndimage", "scipy.optimize", "scipy.spatial", "skimage.measure"),
    *("torch", "trimesh"),
)
OPEN3D = "zeroshop_steps.runtime.open3d_loader"
"""How steps import Open3D. Of the project itself nothing stays: a test may bring its own copy of that."""
PYTHON = """#!{python} -IS
import sys

real, words = {python!r}, sys.argv[1:]
if words[:1] != ["-m"] or not words[1].startswith("zeroshop_steps."):
    import os

    os.execv(real, [real, *words])
import json, os, signal, socket

server = socket.socket(socket.AF_UNIX)
server.connect({address!r})
socket.send_fds(server, [b"outputs"], [0, 1, 2])
with server.makefile("rw") as told:
    told.write(json.dumps([words[1:], os.getcwd(), dict(os.environ)]) + "\\n")
    told.flush()
    step = int(told.readline())
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: os.kill(step, number))
    status = int(told.readline())
if status < 0:
    signal.signal(-status, signal.SIG_DFL)
    os.kill(os.getpid(), -status)
sys.exit(status)
"""


@functools.cache
def warm_python() -> Path:
    """The Python that runs steps as forks; the process behind it ends with this one."""
    folder = tempfile.TemporaryDirectory(prefix="warm-")
    python, address = Path(folder.name, "python"), str(Path(folder.name, "server"))
    python.write_text(PYTHON.format(python=sys.executable, address=address))
    python.chmod(0o755)
    server = subprocess.Popen(
        [sys.executable, "-m", "helpers.warm_steps", address],
        cwd=TESTS,
        env={**os.environ, "PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert server.stdout and server.stdout.readline(), "the process behind the warm Python did not start"
    atexit.register(_end, server, folder)
    return python


def _end(server: subprocess.Popen[bytes], folder: tempfile.TemporaryDirectory[str]) -> None:
    """End the process and wait for it, so that the time that it took counts as time of the tests."""
    server.communicate()
    folder.cleanup()


def _serve(address: str) -> None:
    """Fork for every call until the process that started this one is gone."""
    for name in (*PACKAGES, OPEN3D):
        importlib.import_module(name)
    _start_compiler()
    for name in [name for name in sys.modules if name.partition(".")[0] == "zeroshop_steps"]:
        del sys.modules[name]
    gc.collect()
    gc.freeze()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGCHLD, _collect_ended)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address)
    listener.listen()
    print("ready", flush=True)
    while sys.stdin not in select.select([sys.stdin, listener], [], [])[0]:
        connection = listener.accept()[0]
        if os.fork() == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            listener.close()
            run_and_end(functools.partial(_answer, connection))
        connection.close()


def _start_compiler() -> None:
    """Numba prepares itself when it compiles or loads its first function."""
    import numba

    numba.njit(lambda value: value + 1)(1)


def _collect_ended(number: int, frame: object) -> None:
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _answer(connection: socket.socket) -> None:
    """Run a step in a child process; tell its number and its status. Where nobody listens any more, it is killed."""
    _, outputs, _, _ = socket.recv_fds(connection, 7, 3)
    told = connection.makefile("rw")
    words, folder, environment = json.loads(told.readline())
    child = os.fork()
    if child == 0:
        for here, there in enumerate(outputs):
            os.dup2(there, here)
        run_and_end(functools.partial(_run_step, words, folder, environment))
    print(child, file=told, flush=True)
    ended = os.pidfd_open(child)
    if ended not in select.select([connection, ended], [], [])[0]:
        os.kill(child, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    with contextlib.suppress(BrokenPipeError):
        print(status, file=told, flush=True)


def _run_step(words: list[str], folder: str, environment: dict[str, str]) -> None:
    """Be `python -m WORDS`."""
    import numba

    own = {str(TESTS), *os.environ.get("PYTHONPATH", "").split(os.pathsep)}
    installed = [place for place in sys.path if place not in own]
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    numba.config.reload_config()
    sys.path[:] = [folder, *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep)), *installed]
    sys.argv = words
    runpy.run_module(words[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    _serve(sys.argv[1])
