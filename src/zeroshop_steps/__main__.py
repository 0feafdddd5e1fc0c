"""The command `zeroshop`: its version, and how to make a mesh today."""

import argparse
import sys
from collections.abc import Sequence

from zeroshop_steps import __version__

HELP = """\
Photos or a video of an object become a textured mesh of true size.

ZeroShOP is a Snakemake workflow: name the file that you want, in the folder of the project.

  snakemake -n results/demo/mug/2dgs.ply    show the plan and run nothing
  snakemake results/demo/mug/2dgs.ply       make the mesh of a demo object
  snakemake results/photos/NAME/2dgs.ply    make the mesh of NAME, a row of config/objects.tsv

Each step is also a command of its own:

  python -m zeroshop_steps.STAGE --help                    list the methods of a stage
  python -m zeroshop_steps.STAGE --method METHOD --help    explain one of them

README.md is the introduction, config/README.md the manual."""


def main(argv: Sequence[str] | None = None) -> int:
    """Answer `--version`; print help for anything else. Returns the exit status.

    Args:
        argv: the command line without the program's name; the process's own by default.
    """
    parser = argparse.ArgumentParser(prog="zeroshop", description=HELP, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    parser.parse_args(argv)
    parser.print_help()
    return 0


if __name__ == "__main__":
    sys.exit(main())
