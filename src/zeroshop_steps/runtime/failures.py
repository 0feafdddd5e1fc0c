"""A step that cannot do its work leaves a record in place of its outputs, so that a table goes on with its other cells.

The rules of a cell pass `--record-failure OUTPUT ...`; the name of a folder ends in a slash. The record is one line of JSON with
the step, its reason and the place of the record: the file itself, or failure.json in a folder. A later step that is given one
passes it on, down to the cell's figures. A step without the option, such as the one that puts the mesh at its final path, ends with
the reason and a status of its own instead, so that no product is ever a record.

What the machine did wrong is not recorded, since it says nothing about the cell: a full disk, no memory, a killed process. With
`--record-refusals`, a network for which memory does not suffice is recorded: where a table is to hold what this machine can do.
"""

import contextlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError, explain_machine_fault, is_disk_full, is_out_of_memory
from zeroshop_steps.runtime.files import atomic_directory, atomic_write

START = b'{"failed": "'
IN_FOLDER = "failure.json"
"""The record in an output that is a folder."""
RECORDED = "failed, recorded in "
"""How a line of a step's log begins that the workflow repeats at its end."""


@dataclass(frozen=True)
class Failure:
    """Which step failed and why.

    Attributes:
        step: as in `python -m zeroshop_steps.STAGE --method METHOD`: "STAGE.METHOD".
        reason: one line.
        place: the output in place of which it was first recorded; empty where it was not yet.
    """

    step: str
    reason: str
    place: str = field(default="", compare=False)

    def __str__(self) -> str:
        return f"{self.step}: {self.reason}"


def write_failure(outputs: Sequence[str | Path], failure: Failure, write_details: Callable[[Path], None] | None = None) -> Failure:
    """Leave the record in place of every output.

    Args:
        outputs: files, and folders whose names end in a slash.
        failure: what is recorded; where it has no place yet, that is the first output.
        write_details: writes more into a folder, for whoever wants to see what went wrong.

    Returns:
        the failure with its place.
    """
    failure = replace(failure, place=failure.place or str(outputs[0]).rstrip("/"))
    content = json.dumps({"failed": failure.step, "reason": failure.reason, "place": failure.place}) + "\n"
    for output in outputs:
        if str(output).endswith("/"):
            with atomic_directory(Path(output)) as folder:
                if write_details:
                    write_details(folder)
                (folder / IN_FOLDER).write_text(content)
        else:
            with atomic_write(Path(output)) as temporary:
                temporary.write_text(content)
    return failure


@contextlib.contextmanager
def part_of_step(name: str) -> Iterator[None]:
    """Name the part of a step in which something fails, such as "evaluate.quality": the record then has this name, not the step's."""
    try:
        yield
    except Exception as error:
        vars(error).setdefault("part", name)
        raise


def name_part(error: BaseException, step: str) -> str:
    """The part of a step that an error comes from; the step itself where it has no parts."""
    return str(vars(error).get("part", step))


def read_failure(path: Path) -> Failure | None:
    """The failure that a file or folder records; None where it is a true output or absent."""
    path = Path(path)
    try:
        record = path / IN_FOLDER if path.is_dir() else path
        with record.open("rb") as file:
            if file.read(len(START)) != START:
                return None
        content = json.loads(record.read_text())
        return Failure(content["failed"], content["reason"], content.get("place", str(path)))
    except (OSError, ValueError, KeyError):
        return None


def failure_among(words: Iterable[str]) -> Failure | None:
    """The first failure that a file or folder on a command line records."""
    return next((failure for failure in map(read_failure, map(Path, words)) if failure), None)


def how_to_try_again(place: str) -> str:
    """What a user does about a recorded failure once its cause is mended."""
    return f"To try again, delete {place} or call snakemake with --forcerun {place}."


def is_result(error: BaseException, refusals: bool = False) -> bool:
    """Whether an error says something about the cell, and not about the machine.

    With `refusals`, a step that says in its own words that memory does not suffice counts, too: on this machine it never will.
    """
    if refusals and isinstance(error, StepError) and isinstance(error.__cause__, MemoryError):
        return True
    machine = (OSError, MemoryError, ImportError)
    # Libraries raise these as errors of their own or as RuntimeErrors.
    by_words = is_out_of_memory(error) or is_disk_full(error) or "CUDA error" in str(error) or "start new thread" in str(error)
    return isinstance(error, Exception) and not by_words and not isinstance(error, machine) and not isinstance(error.__cause__, machine)


def reason_of(error: BaseException) -> str:
    """An error in the words of a table: one line, without the colours that some libraries put into theirs."""
    text = str(error) if isinstance(error, StepError) else explain_machine_fault(error) or f"unexpected {type(error).__name__}: {error}"
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", text).split())
