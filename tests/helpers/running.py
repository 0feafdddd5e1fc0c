"""Running the workflow as a user does, in a folder of its own."""

import os
import sys
from pathlib import Path
from subprocess import CompletedProcess

from helpers.paths import SNAKEFILE
from helpers.planner import call_snakemake


def command_and_environment(folder: Path, *arguments: str) -> tuple[list[str], dict[str, str]]:
    """How Snakemake is called in `folder`.

    The folder of this Python is taken off PATH: the workflow has to find its Python alone.
    """
    here = str(Path(sys.executable).parent)
    path = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if part != here)
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(SNAKEFILE), "--directory", str(folder), "--cores", "2", *arguments]
    return command, {**os.environ, "PATH": path, "XDG_CACHE_HOME": str(folder / ".cache")}


def run_snakemake(folder: Path, *arguments: str) -> CompletedProcess[str]:
    """Call Snakemake in `folder`; stdout and stderr come back together in `stdout`."""
    command, environment = command_and_environment(folder, *arguments)
    return call_snakemake(folder, command[command.index("snakemake") + 1 :], environment)


def planned(output: str) -> dict[str, int]:
    """The table of jobs in a dry run's output: count by rule, without the total."""
    lines = output.splitlines()
    starts = [number for number, line in enumerate(lines) if line.startswith("Job stats:")]
    if not starts:
        return {}
    jobs: dict[str, int] = {}
    for line in lines[starts[-1] + 3 :]:
        words = line.split()
        if len(words) != 2 or words[0] == "total":
            break
        jobs[words[0]] = int(words[1])
    return jobs
