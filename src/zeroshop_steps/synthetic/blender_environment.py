"""Set up the environment in which BlenderProc runs, apart from all others, and record which Python it has.

Where this very Python has Blender's module (a conda environment made for it), that one is taken. Otherwise a virtual
environment is made in a folder, from a list of pinned packages. It is done when BlenderProc has been started once.
"""

import argparse
import re
import shutil
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from zeroshop_steps.runtime.check_install import missing_packages
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.synthetic.blender import probe, start

PYTHON = (3, 11)  # the one that Blender's module is built for
# With nothing on the module path but that environment and, behind it, this package.
LAUNCH = "import runpy, sys; sys.path.append(sys.argv.pop(1)); runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
SOURCES = Path(__file__).parents[2]
WITHOUT = "or set renderer: raycast, which needs none of it"
# Shared library -> Debian and Ubuntu package, of those that Blender's module links.
SYSTEM_PACKAGES = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libgomp.so.1": "libgomp1",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--requirements", type=Path, required=True, help="list of pinned packages")
    parser.add_argument("--folder", type=Path, required=True, help="virtual environment to make where this Python lacks Blender")
    parser.add_argument("--out", type=Path, required=True, help="record to write (JSON)")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    python = Path(sys.executable) if find_spec("bpy") else make_environment(args.requirements, args.folder)
    versions = {"bpy": start.BPY_VERSION, "blenderproc": start.BLENDERPROC_VERSION}
    for _ in _read_messages(python, probe, [], f"the Python {python}"):
        pass
    write_json(args.out, {"python": str(python), **versions})


def make_environment(requirements: Path, folder: Path) -> Path:
    """Make a virtual environment or complete one; returns its Python.

    Raises:
        StepError: no Python of the right version, or pip failed.
    """
    if not requirements.is_file():
        raise StepError(f"{requirements} does not exist; it lists what BlenderProc needs")
    name = "python{}.{}".format(*PYTHON)
    python = folder.absolute() / "bin" / "python"
    if not python.exists():
        _make_folder(name, folder)
    pip = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off", "-r", str(requirements)]
    _run_command(pip, f"cannot install {requirements}: check the network (and PIP_INDEX_URL), or delete {folder} and try again, {WITHOUT}")
    return python


def _make_folder(name: str, folder: Path) -> None:
    """Make the environment with a Python that is there, or with one that uv or conda fetches: distributions have one version alone."""
    version = name.removeprefix("python")
    base = sys.executable if sys.version_info[:2] == PYTHON else shutil.which(name)
    conda = next((found for one in ("micromamba", "mamba", "conda") if (found := shutil.which(one))), None)
    if base:
        _run_command([base, "-m", "venv", str(folder)], "cannot make a virtual environment: install python3-venv")
    elif uv := shutil.which("uv"):
        _run_command([uv, "venv", "--seed", "--python", version, str(folder)], f"uv cannot get {name}: check the network, {WITHOUT}")
    elif conda:
        command = [conda, "create", "--yes", "--prefix", str(folder), "--channel", "conda-forge", f"python={version}", "pip"]
        _run_command(command, f"{conda} cannot get {name}: check the network, {WITHOUT}")
    else:
        raise StepError(
            f"Blender's module needs {name}, which is not on the PATH; where your system has another version alone, `pip install uv` lets"
            f" this step fetch it; or use --sdm conda, {WITHOUT}"
        )


def run_script(environment: Path, script: ModuleType, arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Run a module of `blender/` in BlenderProc's environment; yields what it tells: (kind, text).

    Raises:
        StepError: the environment is gone, BlenderProc does not start there, or it failed or was killed.
    """
    record = read_json(environment)
    python = Path(record["python"])
    remedy = f"delete {environment} and run again to set it up"
    if not python.exists():
        raise StepError(f"the Python {python} of BlenderProc's environment is gone; {remedy}")
    yield from _read_messages(python, script, arguments, f"the Python {python} that {environment} names")


def _read_messages(python: Path, script: ModuleType, arguments: Sequence[str], where: str) -> Iterator[tuple[str, str]]:
    """Yield the lines that a module of `blender/` tells; the process never outlives this."""
    last: deque[str] = deque(maxlen=12)
    command = [str(python), "-I", "-c", LAUNCH, str(SOURCES), script.__name__, *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    assert process.stdout is not None, "it is a pipe"
    ready = False
    try:
        for line in process.stdout:
            kind, _, text = line.rstrip().partition(" ")
            if kind == "@fault":
                raise StepError(explain_fault(text, where))
            ready |= kind == "@ready"
            if kind.startswith("@"):
                yield kind[1:], text
            elif line.strip():
                last.append(line.rstrip())
        status = process.wait()
    finally:
        process.kill()
        process.wait()
    if status == -signal.SIGKILL:
        raise StepError(
            "Blender was killed, most often because memory ran out; give it more, or make images smaller."
            " Frames that were finished stay: the same command goes on from there"
        )
    if status or not ready:
        reason = signal.Signals(-status).name if status < 0 else f"status {status}"
        raise StepError(f"Blender ended with {reason}. Its last words:\n" + "\n".join(last))


def explain_fault(reason: str, where: str) -> str:
    """Why BlenderProc does not start, with the remedy.

    Args:
        reason: the words of an ImportError.
        where: the environment, for the message.
    """
    library = re.match(r"(lib\S+\.so\S*): cannot open shared object file", reason)
    if library:
        package = SYSTEM_PACKAGES.get(library[1])
        all_missing = " ".join(dict.fromkeys([package or "", *missing_packages(SYSTEM_PACKAGES)]))
        remedy = f"sudo apt-get install {all_missing}" if package else f"install the package that has it (apt-file search {library[1]})"
        return f"Blender needs the system library {library[1]}, which is missing. Run: {remedy}; {WITHOUT}"
    module = re.match(r"No module named '([^']+)'", reason)
    if module:
        return f"{where} lacks the module {module[1]}; set the environment up again (workflow/envs/blenderproc.txt), {WITHOUT}"
    return f"{where} does not run BlenderProc: {reason}; set the environment up again (workflow/envs/blenderproc.txt), {WITHOUT}"


def _run_command(command: Sequence[str], failure: str) -> None:
    """Run a command, its output to the log."""
    if subprocess.run(command, stdout=sys.stderr, check=False).returncode != 0:
        raise StepError(failure)
