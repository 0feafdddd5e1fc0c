"""Results that look finished to Snakemake without any step having run, for tests of what is stale."""

from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess


def pretend(snakemake: Callable[..., CompletedProcess[str]], folder: Path, *targets: str) -> None:
    """Put an empty file or folder in place of every output behind the targets, and have Snakemake record all as made.

    A checkpoint hides what comes after it until it is there, hence the rounds.
    """
    while True:
        listed = snakemake("--summary", *targets)
        assert listed.returncode == 0, listed.stdout
        rows = [line.split("\t") for line in listed.stdout.splitlines() if line.startswith("results/")]
        missing = [folder / row[0] for row in rows if row[4] == "missing"]
        if not missing:
            return
        for path in missing:
            if path.suffix:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text('{"failed": null}\n')
            else:
                path.mkdir(parents=True, exist_ok=True)
        touched = snakemake("--touch", "--forceall", *targets)
        assert touched.returncode == 0, touched.stdout
