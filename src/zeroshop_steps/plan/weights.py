"""Which files of weights a user asks for by a name, and whether their licences were agreed to."""

from collections.abc import Callable, Iterable
from pathlib import Path

from zeroshop_steps import methods
from zeroshop_steps.methods import WEIGHTS_FOLDER, Method
from zeroshop_steps.networks.weights import WeightsFile, read_table
from zeroshop_steps.plan.choices import Choices
from zeroshop_steps.runtime.errors import StepError

AGREED = f"{WEIGHTS_FOLDER}/agreed"
"""The folder of the licences that were agreed to."""


def list_sets(choices: Choices) -> dict[str, list[Method]]:
    """What weights can be asked for: all of the thesis's tables with the networks that it took, or a method, with those of the config."""
    of_thesis = [
        methods.HEIGHTS["mast3r"],
        *map(methods.REGISTRATIONS.__getitem__, ("mast3r", "vggt_1024")),
        methods.SEGMENTATIONS["grounded_sam"],
        methods.SURFACES["trellis"],
        methods.DETECTORS["cnos"].with_options({"proposals": "fastsam"}),
        methods.DETECTORS["sam6d_ism"].with_options({"proposals": "sam"}),
        *map(methods.ESTIMATORS.__getitem__, ("foundationpose", "sam6d_pem")),
    ]
    named = {
        name: choices.with_own_weights(section, method) for section, table in methods.SECTIONS.items() for name, method in table.items()
    }
    return {"weights": of_thesis, **{f"weights/{name}": [method] for name, method in named.items() if method.files}}


def list_files(chosen: Iterable[Method]) -> list[WeightsFile]:
    """The known files of some methods."""
    table = read_table()
    return [table[file] for file in sorted({file for method in chosen for file in method.files}) if file in table]


def require_agreed(rows: list[WeightsFile], agreed: bool, say: Callable[[str], None]) -> list[str]:
    """The paths of files, once their licences were agreed to; says sizes and licences of those that will be downloaded.

    Args:
        rows: the files.
        agreed: whether the user agrees now.
        say: tells the user a line.

    Raises:
        StepError: names the licences that are to be agreed to.
    """
    lacking = [row for row in rows if not row.path.is_file()]
    for row in lacking:
        size = f"{row.size_bytes / 1e6:.0f} MB" if row.size_bytes else "size not published"
        say(f"{row.file}: {size}, {row.licence}, from {row.source}")
    if lacking:
        say(f"{len(lacking)} files, {sum(row.size_bytes or 0 for row in lacking) / 1e9:.1f} GB and those without a size")
    known = [line for path in Path(AGREED).glob("*.txt") for line in path.read_text().splitlines()]
    asked = sorted({row.licence for row in lacking} - set(known))
    if asked and not agreed:
        raise StepError(f"these files have the licences {'; '.join(asked)}. If you agree to them, add: --config licences=agreed (once)")
    return [str(row.path) for row in rows]


def weights_of(choices: Choices, chosen: list[Method]) -> Callable[..., list[str]]:
    """An input function: the weights of some methods."""
    rows, agreed = list_files(chosen), choices.config["licences"] == "agreed"
    return lambda wildcards: require_agreed(rows, agreed, choices.say)
