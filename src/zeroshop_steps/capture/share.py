"""Take over a folder of another object, whose photos show this one, too: a capture or a registered scene, by links where possible."""

import argparse
import shutil
from pathlib import Path

from zeroshop_steps.runtime.files import atomic_directory, link_or_copy


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    parser.add_argument("--folder", type=Path, required=True, help="folder to take over")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Write the folder. Snakemake's own hidden file is not linked: it is touched, and that would make the other object's folder stale."""
    hidden = shutil.ignore_patterns(".*")
    with atomic_directory(args.out) as folder:
        shutil.copytree(args.folder, folder, ignore=hidden, copy_function=link_or_copy, dirs_exist_ok=True)
