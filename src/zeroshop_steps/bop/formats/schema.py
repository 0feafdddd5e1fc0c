"""Read BOP's JSON files and check them against schemas; errors name the place in the file."""

import functools
import gzip
import json
import math
from pathlib import Path
from typing import Any

import jsonschema

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, read_json_value


def read_validated(path: Path, kind: str) -> Any:
    """Read a JSON file, gzipped if its name ends in .gz, and check it against the schema `kind` in schemas.json.

    Raises:
        StepError: the file is missing or damaged, an entry has the wrong form, or a number is not finite.
    """
    content = _as_official(read_content(path))
    check_content(path, content, kind)
    return content


def _as_official(content: Any, key: str = "") -> Any:
    """Content as the official loader takes it: numbers with zeros before them or a point behind them, matrices of a camera as rows."""
    if isinstance(content, dict):
        return {str(int(name)) if name.isdecimal() else name: _as_official(value, name) for name, value in content.items()}
    if not isinstance(content, list):
        whole = isinstance(content, float) and content.is_integer() and key.endswith(("_id", "_count"))
        return int(content) if whole else content
    if key.startswith("cam_") and all(isinstance(row, list) for row in content):
        return [number for row in content for number in row]
    return [_as_official(one) for one in content]


def read_content(path: Path) -> Any:
    """The content of a JSON file, gzipped if its name ends in .gz. Raises StepError where it is missing or damaged."""
    return _read_gzipped(path) if Path(path).suffix == ".gz" else read_json_value(path)


def check_content(path: Path, content: Any, kind: str) -> None:
    """Check content that was read from `path` against the schema `kind`; raises StepError as `read_validated` does."""
    error = next(_validator(kind).iter_errors(content), None)
    if error is not None:
        raise StepError(f"{path}: {_place(error)}{error.message[:200]}; BOP's format is described in bop_datasets_format.md of bop_toolkit")
    _check_finite(path, content, ())


@functools.cache
def _validator(kind: str) -> jsonschema.Draft202012Validator:
    schemas = read_json(Path(__file__).with_name("schemas.json"))
    return jsonschema.Draft202012Validator({"$ref": f"#/$defs/{kind}", **schemas})


def _place(error: jsonschema.ValidationError) -> str:
    where = " / ".join(str(part) for part in error.absolute_path)
    return f"at {where}: " if where else ""


def _check_finite(path: Path, content: Any, where: tuple[str, ...]) -> None:
    """Raise StepError if a number is NaN or infinite; JSON has no such numbers, but Python's parser reads them."""
    if isinstance(content, float) and not math.isfinite(content):
        raise StepError(f"{path}: at {' / '.join(where)}: {content} is not a finite number; remove or repair the entry")
    if isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            if isinstance(value, dict | list | float):
                _check_finite(path, value, (*where, str(key)))


def _read_gzipped(path: Path) -> Any:
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            return json.load(file)
    except FileNotFoundError:
        raise StepError(f"{path} does not exist; check the path, or run the step that writes it") from None
    except (OSError, EOFError, UnicodeDecodeError, RecursionError, json.JSONDecodeError) as error:
        raise StepError(f"{path} is not gzipped JSON ({error}); fetch it again") from None
