"""Link an object's mesh and the files beside it under another name of the object: one set of files, found by both."""

import argparse
import os
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError, remedy_for


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--files", type=Path, nargs="+", required=True, help="the mesh and the files beside it")
    parser.add_argument("--links", type=Path, nargs="+", required=True, help="a link for each, in the same order")


def run(args: argparse.Namespace) -> None:
    """Write the links, relative ones, so that the folder of results can be moved."""
    if len(args.files) != len(args.links):
        raise StepError(f"{len(args.files)} files and {len(args.links)} links were given; expected a link for each file")
    for file, link in zip(args.files, args.links, strict=True):
        if not file.is_file():
            raise StepError(f"{file} does not exist; make the mesh first")
        try:
            link.unlink(missing_ok=True)
            link.symlink_to(os.path.relpath(file, link.parent))
        except OSError as error:
            raise StepError(f"{link} cannot be made a link to {file}: {error.strerror}. {remedy_for(error)}") from None
