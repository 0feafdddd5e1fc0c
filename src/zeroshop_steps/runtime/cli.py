"""Every step is a command: `python -m zeroshop_steps.STAGE --method METHOD ...`.

A stage is a package; each of its methods is a module with `add_arguments(parser)` and `run(args)`, and the module's
docstring is its help. Nothing else registers a method. A method with `READS_FAILURES = True` takes records of failures
(failures.py) as inputs; the others pass them on unread.
"""

import argparse
import importlib
import importlib.util
import re
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from zeroshop_steps.runtime import failures
from zeroshop_steps.runtime.cache import run_cached
from zeroshop_steps.runtime.errors import StepError

RUN = re.compile(r"^def run\(args\b", re.MULTILINE)


def stage_main(package: str, argv: Sequence[str] | None = None) -> int:
    """Run one method of a stage and return the exit status.

    Args:
        package: the stage's package, e.g. "zeroshop_steps.register".
        argv: the command line without the program's name; the process's own by default.
    """
    if argv is None:
        # A scheduler's request to end is taken like Ctrl+C, so that nothing half-written stays.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    argv = list(sys.argv[1:] if argv is None else argv)
    choose = argparse.ArgumentParser(prog=f"python -m {package}", add_help=False)
    choose.add_argument("--method", choices=stage_methods(package), required=True)
    choose.add_argument("--record-failure", type=Path, nargs="+", default=[], metavar="OUTPUT")
    if not any(word == "--method" or word.startswith("--method=") for word in argv) and {"-h", "--help"} & set(argv):
        choose.print_help()
        return 0
    known, rest = choose.parse_known_args(argv)
    step = f"{package.rpartition('.')[2]}.{known.method}"
    module = importlib.import_module(f"{package}.{known.method}")
    inputs = [word for word in rest if Path(word) not in known.record_failure]
    earlier = None if getattr(module, "READS_FAILURES", False) else failures.failure_among(inputs)
    if earlier:
        return _give_up(earlier, known.record_failure)
    parser = argparse.ArgumentParser(
        prog=f"python -m {package} --method {known.method}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    args = parser.parse_args(rest)
    try:
        run_cached(step, module, args)
    except KeyboardInterrupt:
        print("interrupted; nothing half-written was left behind", file=sys.stderr)
        return 130
    except Exception as error:
        if not isinstance(error, StepError):
            traceback.print_exc()
        failure = failures.Failure(step, failures.reason_of(error))
        return _give_up(failure, known.record_failure if failures.is_result(error) else [])
    return 0


def _give_up(failure: failures.Failure, outputs: Sequence[Path]) -> int:
    """End with a failure's reason; in a table run, leave its record in place of `outputs` and let the others go on."""
    if outputs and failures.recording():
        failures.write_failure(outputs, failure)
        print(f"failed, recorded in {outputs[0]}: {failure}", file=sys.stderr)
        return 0
    print(f"error: {failure.reason}", file=sys.stderr)
    return 1


def stage_methods(package: str) -> list[str]:
    """The methods of a stage, sorted: its modules and sub-packages that define `run(args)`. Their sources are read, not imported."""
    spec = importlib.util.find_spec(package)
    folders = spec.submodule_search_locations if spec else None
    found = set()
    for folder in map(Path, folders or []):
        for path in [*folder.glob("*.py"), *folder.glob("*/__init__.py")]:
            name = path.parent.name if path.name == "__init__.py" else path.stem
            if not name.startswith("_") and RUN.search(path.read_text()):
                found.add(name)
    return sorted(found)
