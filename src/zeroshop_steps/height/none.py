"""Leave the scale unknown: the mesh keeps the registration's arbitrary one. A scale is never guessed."""

import argparse

from zeroshop_steps.height.record import add_common_arguments, write_height

METHOD = {"rank": 4}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write height.json."""
    write_height(args, "none", lambda registered: None)
