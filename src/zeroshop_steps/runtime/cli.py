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
from collections.abc import Callable, Sequence
from pathlib import Path

from zeroshop_steps.runtime import failures
from zeroshop_steps.runtime.cache import run_cached
from zeroshop_steps.runtime.child_process import wait_for_child
from zeroshop_steps.runtime.compute.freed_memory import keep_freed_memory
from zeroshop_steps.runtime.compute.kernel_cache import provide_kernel_cache
from zeroshop_steps.runtime.errors import StepError, explain_machine_fault

RECORD_FAILURE = (
    "outputs (a folder's name ends in a slash) in place of which a failure is recorded, but for those that were written before it;"
    " the status is 0 then"
)
RECORD_REFUSALS = "record that memory does not suffice for a network, too, as a failure"
READS = re.compile(r"^READS_FAILURES = True$", re.MULTILINE)
RUN = re.compile(r"^def run\(args\b", re.MULTILINE)


def stage_main(package: str, argv: Sequence[str] | None = None) -> int:
    """Run one method of a stage and return the exit status.

    Args:
        package: the stage's package, e.g. "zeroshop_steps.register".
        argv: the command line without the program's name; the process's own by default.
    """
    if argv is None:
        argv = sys.argv[1:]
        status = wait_for_child(_find_out(argv))
        if status is not None:
            return status
        # A scheduler's request to end is taken like Ctrl+C, so that nothing half-written stays.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    argv = list(argv)
    choose = argparse.ArgumentParser(prog=f"python -m {package}", add_help=False)
    choose.add_argument("--method", choices=stage_methods(package), required=True)
    choose.add_argument("--record-failure", nargs="+", default=[], metavar="OUTPUT", help=RECORD_FAILURE)
    choose.add_argument("--record-refusals", action="store_true", help=RECORD_REFUSALS)
    if not any(word == "--method" or word.startswith("--method=") for word in argv) and {"-h", "--help"} & set(argv):
        choose.print_help()
        return 0
    known, rest = choose.parse_known_args(argv)
    provide_kernel_cache()
    keep_freed_memory()
    step = f"{package.rpartition('.')[2]}.{known.method}"
    own = {Path(output) for output in known.record_failure}
    inputs = [word for word in rest if Path(word) not in own]
    # Before the method is imported: of a failed cell, the imports would take all of the time.
    earlier = None if _reads_failures(f"{package}.{known.method}") else failures.failure_among(inputs)
    if earlier:
        return _give_up(earlier, known.record_failure)
    module = importlib.import_module(f"{package}.{known.method}")
    parser = argparse.ArgumentParser(
        prog=f"python -m {package} --method {known.method}",
        description=module.__doc__,
        epilog=f"--record-failure OUTPUT ...: {RECORD_FAILURE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    args = parser.parse_args(rest)
    before = {output: _find_stamp(output) for output in known.record_failure}
    try:
        run_cached(step, module, args)
    except KeyboardInterrupt:
        print("interrupted; nothing half-written was left behind", file=sys.stderr)
        return 130
    except Exception as error:
        if not isinstance(error, StepError) and not explain_machine_fault(error):
            traceback.print_exc()
        failure = failures.Failure(failures.name_part(error, step), failures.reason_of(error))
        details = error.write_details if isinstance(error, StepError) else None
        missing = [output for output, stamp in before.items() if _find_stamp(output) == stamp]
        return _give_up(failure, missing if failures.is_result(error, known.record_refusals) else [], details)
    return 0


def run_method(package: str, method: str, words: Sequence[str]) -> None:
    """Run a method of another stage as a part of a step, by the words of its command line.

    Raises:
        StepError: as the method does.
    """
    module = importlib.import_module(f"{package}.{method}")
    parser = argparse.ArgumentParser(prog=f"python -m {package} --method {method}")
    module.add_arguments(parser)
    module.run(parser.parse_args(words))


def _find_stamp(output: str) -> tuple[int, int] | None:
    """What changes where an output is written anew; None without one."""
    try:
        found = Path(output).stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _reads_failures(method: str) -> bool:
    """Whether a method's source says so; it is read, not imported."""
    spec = importlib.util.find_spec(method)
    return bool(spec and spec.origin and READS.search(Path(spec.origin).read_text()))


def _find_out(argv: Sequence[str]) -> Path | None:
    """What a command line names as --out."""
    return next((Path(value) for word, value in zip(argv, argv[1:], strict=False) if word == "--out"), None)


def _give_up(failure: failures.Failure, outputs: Sequence[str], write_details: Callable[[Path], None] | None = None) -> int:
    """Record a failure in place of `outputs`, or end with its reason where there are none. Returns the status."""
    if outputs:
        failure = failures.write_failure(outputs, failure, write_details)
        print(f"{failures.RECORDED}{failure.place}: {failure}", file=sys.stderr)
        return 0
    print(f"error: {failure.reason}", file=sys.stderr)
    if failure.place:
        print(f"This is the failure of {failure.step}. {failures.how_to_try_again(failure.place)}", file=sys.stderr)
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
