"""Every step is a command: `python -m zeroshop_steps.STAGE --method METHOD ...`.

A stage is a package; each of its methods is a module with `add_arguments(parser)` and `run(args)`, and the module's
docstring is its help. Nothing else registers a method.
"""

import argparse
import importlib
import pkgutil
import sys
from collections.abc import Sequence

from zeroshop_steps.errors import StepError


def stage_main(package: str, methods: Sequence[str], argv: Sequence[str] | None = None) -> int:
    """Run one method of a stage and return the exit status.

    Args:
        package: the stage's package, e.g. "zeroshop_steps.register".
        methods: the names of its modules (or sub-packages) that are methods.
        argv: the command line without the program's name; the process's own by default.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    choose = argparse.ArgumentParser(prog=f"python -m {package}", add_help=False)
    choose.add_argument("--method", choices=methods, required=len(methods) > 1, default=methods[0])
    if not any(word == "--method" or word.startswith("--method=") for word in argv) and {"-h", "--help"} & set(argv):
        choose.print_help()
        return 0
    known, rest = choose.parse_known_args(argv)
    module = importlib.import_module(f"{package}.{known.method}")
    parser = argparse.ArgumentParser(
        prog=f"python -m {package} --method {known.method}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    args = parser.parse_args(rest)
    try:
        module.run(args)
    except StepError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; nothing half-written was left behind", file=sys.stderr)
        return 130
    return 0


def stage_methods(package_path: Sequence[str]) -> list[str]:
    """The names of all modules and sub-packages in a folder, for tests that every listed method exists."""
    return [module.name for module in pkgutil.iter_modules(package_path) if not module.name.startswith("_")]
