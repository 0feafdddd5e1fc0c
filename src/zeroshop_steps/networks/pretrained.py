"""Models of the transformers library from a folder of their files, whole or not at all."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, read_table, require_weights
from zeroshop_steps.runtime.errors import StepError

WEIGHTS_FILE = "model.safetensors"
REMEDY = "get the file again, or use a method that needs no weights"


def require_model(name: str, files: Sequence[str]) -> Path:
    """The folder of a model below resources/weights, with all its files: those of the table checked, others merely there.

    Raises:
        StepError: a file is missing, empty, or not what its publisher has.
    """
    table = read_table()
    for file in files:
        require_weights(f"{name}/{file}") if f"{name}/{file}" in table else require_file(WEIGHTS_FOLDER / name / file)
    return WEIGHTS_FOLDER / name


def load_pretrained(model_class: type[Any], folder: Path, device: torch.device) -> Any:
    """A model in evaluation mode, float32, with every one of its parameters from `folder`.

    Args:
        model_class: of transformers.
        folder: config.json and model.safetensors, as `save_pretrained` writes them.
        device: where to put it.

    Raises:
        StepError: a file is missing, damaged, cut off, or of another model.
    """
    for name in ("config.json", WEIGHTS_FILE):
        require_file(folder / name)
    try:
        with _quietly():
            model, report = model_class.from_pretrained(
                folder, local_files_only=True, use_safetensors=True, dtype=torch.float32, output_loading_info=True
            )
    except Exception as error:  # the library raises what its parts raise: its own, safetensors', json's and torch's errors
        raise StepError(
            f"{folder / WEIGHTS_FILE} cannot be loaded ({_first_line(error)}): it is damaged, cut off or of another model; {REMEDY}"
        ) from None
    lacking = sorted({*report["missing_keys"], *(key for key, *_ in report["mismatched_keys"])})
    if lacking:
        raise StepError(
            f"{folder / WEIGHTS_FILE} lacks {len(lacking)} of the parameters of {model_class.__name__}, among them {lacking[0]}: "
            f"it is of another model or version; {REMEDY}"
        )
    return model.eval().requires_grad_(False).to(device)


def load_part(part_class: type[Any], folder: Path, *files: str) -> Any:
    """A tokenizer or processor from the named files of a model's folder, which must all be there.

    Raises:
        StepError: one is missing or damaged.
    """
    for name in files:
        require_file(folder / name)
    try:
        with _quietly():
            return part_class.from_pretrained(folder, local_files_only=True)
    except Exception as error:
        raise StepError(f"{folder}: {', '.join(files)} cannot be read ({_first_line(error)}); {REMEDY}") from None


def require_file(path: Path) -> Path:
    """The path, or an error where there is no such file or an empty one."""
    if not path.is_file() or not path.stat().st_size:
        raise StepError(f"{path} {'is empty' if path.is_file() else 'does not exist'}; {REMEDY}")
    return path


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Keep transformers from saying, on the way, what is then raised as an error."""
    from transformers.utils import logging

    verbosity = logging.get_verbosity()
    logging.set_verbosity(logging.CRITICAL)
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(verbosity)


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
