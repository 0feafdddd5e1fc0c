"""Reading and checking what the user writes: the config and the table of own captures.

Schemas say what is allowed; this module turns their verdicts into errors that name the key, the row and near matches.
"""

import csv
import difflib
import json
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from zeroshop_steps.runtime.errors import StepError, remedy_for

Row = dict[str, Any]
MOVED_KEYS = {"finish.device": "devices.kernels", "simulate.mass_kg": "assets.masses_kg, by dataset and object"}
"""Keys of earlier versions that are called otherwise now."""
RESERVED_NAMES = ("bop", "tables", "report")
"""Folders of a dataset's results that belong to all of it; no object may have such a name."""


def name_error(what: str, name: str, names: Iterable[str], remedy: str = "") -> str:
    """The message for an unknown name: what exists, the nearest of it, and what to do."""
    names = list(names)
    begun = [known for known in names if name and known.startswith(name)]
    near = begun if len(begun) == 1 else difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    hint = f" Did you mean {' or '.join(near)}?" if near else ""
    return f"unknown {what}: {name}.{hint} Known: {', '.join(names) or 'none'}. {remedy}".rstrip()


def read_config_schema(path: Path, choices: Mapping[str, Iterable[str]], sections: Mapping[str, Iterable[str]]) -> dict[str, Any]:
    """The JSON schema of the config, with the names that only the code knows.

    Args:
        path: the schema's file.
        choices: what a definition ($defs) of the schema may be.
        sections: names that a part of the config may have besides those that the schema describes; their options are a mapping,
            which their own step checks.
    """
    schema = read_yaml(path)
    for name, values in choices.items():
        schema["$defs"][name]["enum"] = list(values)
    for section, names in sections.items():
        properties = schema["properties"][section]["properties"]
        properties |= {name: {"type": "object"} for name in names if name not in properties}
    return schema


def check_config(config: dict[str, Any], schema: Mapping[str, Any]) -> None:
    """Check a config against its JSON schema; numbers that the command line gave as text become numbers in place.

    Raises:
        StepError: lists every fault with the key's path, what was found and what is allowed.
    """
    _read_numbers(config, schema)
    faults = [*_faults(config, schema), *_name_faults(config), *_number_faults(config)]
    if faults:
        raise StepError("the config has faults:\n  " + "\n  ".join(faults) + "\nconfig/KEYS.md describes every key.")


def _name_faults(config: Mapping[str, Any]) -> list[str]:
    """Objects of the config with names that belong to the workflow."""
    datasets = config.get("datasets")
    faults = []
    for name, dataset in datasets.items() if isinstance(datasets, Mapping) else ():
        films = dataset.get("of") if isinstance(dataset, Mapping) else None
        lists = {"objects": dataset.get("objects")} if isinstance(dataset, Mapping) else {}
        lists |= {f"of.{source}": objects for source, objects in films.items()} if isinstance(films, Mapping) else {}
        for key, objects in lists.items():
            taken = sorted(set(RESERVED_NAMES) & set(map(str, objects if isinstance(objects, list) else [])))
            if taken:
                faults.append(f"datasets.{name}.{key}: {', '.join(taken)} is a folder of the whole dataset; give the object another name")
    return faults


def _number_faults(content: Any, key: str = "") -> list[str]:
    """Numbers that are not finite: every comparison with NaN is false, so that it passes all ranges of a schema."""
    if isinstance(content, float) and not math.isfinite(content):
        return [f"{key}: {content} is not a finite number"]
    if isinstance(content, Mapping | list):
        items = content.items() if isinstance(content, Mapping) else enumerate(content)
        return [fault for name, value in items for fault in _number_faults(value, f"{key}.{name}" if key else str(name))]
    return []


def config_changes(config: Mapping[str, Any], defaults_path: Path, ignored: Iterable[str] = ()) -> list[str]:
    """What a config changes of the file of defaults, as words for Snakemake's `--config`: KEY=VALUE, VALUE in JSON, which is YAML.

    Args:
        config: as Snakemake merged it.
        defaults_path: config/config.yaml.
        ignored: keys that results do not depend on.
    """
    changed = _difference(config, read_yaml(defaults_path))
    return [to_config_word(key, value) for key, value in changed.items() if key not in set(ignored)]


def to_config_word(key: str, value: Any) -> str:
    """A value of the config as a word for Snakemake's `--config`, which takes quotes off both ends: spaces keep them, and so what is in it
    that YAML knows, such as ` #`."""
    text = json.dumps(value, ensure_ascii=False)
    return f"{key}= {text} " if isinstance(value, str) and not re.fullmatch(r"[\w./-]*", value) else f"{key}={text}"


def _difference(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """What of `values` is not as in `defaults`, as deep as both are mappings."""
    changed = {}
    for key, value in values.items():
        default = defaults.get(key)
        if isinstance(value, Mapping) and isinstance(default, Mapping):
            below = _difference(value, default)
            if below:
                changed[key] = below
        elif value != default:
            changed[key] = value
    return changed


def read_objects(
    table: Path, schema_path: Path, height_methods: Iterable[str], given_heights: Iterable[str] = ()
) -> dict[tuple[str, str], Row]:
    """Read the table of the user's own captures.

    Args:
        table: tab-separated, with a header; columns as in the schema, of which the `required` ones must be there. Lines that
            start with # are skipped.
        schema_path: the JSON schema of one row.
        height_methods: what the column height_method may name.
        given_heights: those of them that need a height_m.

    Returns:
        rows by (dataset, object), in the table's order. `height_m` and `mass_kg` are floats or None, `picture_count` is an integer or
        None; a column that is not there is empty.

    Raises:
        StepError: names the table, the line and the column.
    """
    try:
        lines = Path(table).read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise StepError(f"{table} does not exist; objects_table in the config names it") from None
    except UnicodeDecodeError:
        raise StepError(f"{table} is not UTF-8 text; save it as tab-separated text") from None
    except OSError as error:
        raise StepError(f"{table} cannot be read: {error.strerror}. objects_table in the config names it. {remedy_for(error)}") from None
    numbered = [(number, line) for number, line in enumerate(lines, start=1) if line.strip() and not line.startswith("#")]
    if not numbered:
        raise StepError(f"{table} is empty; its first line names the columns")
    columns = numbered[0][1].split("\t")
    schema = read_yaml(schema_path)
    schema["properties"]["height_method"]["enum"] = ["", *height_methods]
    _check_columns(table, columns, schema["properties"], schema["required"])
    rows: dict[tuple[str, str], Row] = {}
    for number, line in numbered[1:]:
        try:
            [cells] = csv.reader([line], delimiter="\t", strict=True)
        except csv.Error:
            raise StepError(f"{table}, line {number}: a quotation mark without its other half; give both or none") from None
        if len(cells) > len(columns):
            raise StepError(
                f"{table}, line {number}: {len(cells)} cells, but the header names {len(columns)} columns; separate cells by one tab"
            )
        cells = [cell.strip() for cell in cells] + [""] * (len(columns) - len(cells))
        row: Row = dict.fromkeys(schema["properties"], "") | dict(zip(columns, cells, strict=True))
        row |= {name: _number(row[name]) if row[name] else None for name in ("height_m", "mass_kg", "picture_count", "number")}
        faults = _faults(row, schema)
        if faults:
            raise StepError(f"{table}, line {number}: " + "; ".join(faults))
        row |= {name: int(row[name]) if row[name] else None for name in ("picture_count", "number")}
        if row["object"] in RESERVED_NAMES:
            raise StepError(f"{table}, line {number}: {row['object']} is a folder of the whole dataset; give the object another name")
        if row["height_method"] in set(given_heights) and row["height_m"] is None:
            raise StepError(f"{table}, line {number}: height_method {row['height_method']} needs the height in metres in height_m")
        if bool(row["scene_of"]) != bool(row["number"]):
            raise StepError(f"{table}, line {number}: scene_of and number belong together; give both or none")
        key = row["dataset"], row["object"]
        if key in rows:
            raise StepError(f"{table}, line {number}: {key[0]} {key[1]} is there twice; give each capture a name of its own")
        rows[key] = row
    for (dataset, name), row in rows.items():
        owner = row["scene_of"]
        if owner and ((dataset, owner) not in rows or rows[dataset, owner]["scene_of"]):
            raise StepError(f"{table}: {dataset} {name}: scene_of names {owner}, which is no object of {dataset} with photos of its own")
    return rows


def _check_columns(table: Path, columns: list[str], known: Mapping[str, Any], required: list[str]) -> None:
    """Raise where a column is missing, unknown or doubled."""
    missing = [name for name in required if name not in columns]
    if missing:
        raise StepError(f"{table} lacks the column {', '.join(missing)}; the first line must name {', '.join(required)}, separated by tabs")
    for name in columns:
        if name not in known:
            raise StepError(f"{table}: {name_error('column', name, known)}")
        if columns.count(name) > 1:
            raise StepError(f"{table}: the column {name} is there twice")


def _read_numbers(config: dict[str, Any], schema: Mapping[str, Any]) -> None:
    """Turn text into a number where the schema wants one: `--config 'capture={image_width_px: 640}'` arrives as text."""
    for error in jsonschema.Draft202012Validator(schema).iter_errors(config):
        if error.validator == "type" and isinstance(error.instance, str) and error.validator_value in ("integer", "number"):
            holder: Any = config
            for part in list(error.absolute_path)[:-1]:
                holder = holder[part]
            value = yaml.safe_load(error.instance)
            if isinstance(value, int | float):
                holder[error.absolute_path[-1]] = value


def _number(text: str) -> float | str:
    """A number where the text is a finite one; the text itself otherwise, for the schema to refuse."""
    try:
        number = float(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else text


def check_encoding(path: Path) -> None:
    """Raise StepError where a text file is not UTF-8: Snakemake ends with a traceback that does not name the file."""
    content = Path(path).read_bytes()
    try:
        content.decode()
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise StepError(f"{path} is not UTF-8 text: see line {line}. Save it again with the encoding UTF-8") from None


def read_yaml(path: Path) -> Any:
    """The content of a YAML file."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's is ten times faster, where PyYAML was built with it
    return yaml.load(Path(path).read_text(), Loader=loader)


def _faults(data: Mapping[str, Any], schema: Mapping[str, Any]) -> list[str]:
    """One line for every way in which `data` breaks the schema."""
    validator = jsonschema.Draft202012Validator(schema)
    errors = sorted(validator.iter_errors(data), key=lambda error: [str(part) for part in error.absolute_path])
    return [line for error in errors for line in _explain(error)]


def _explain(error: jsonschema.ValidationError) -> list[str]:
    """A schema error in the user's words."""
    key = ".".join(str(part) for part in error.absolute_path)
    if error.validator == "additionalProperties":
        allowed = list(error.schema.get("properties", {}))
        where = f" in {key}" if key else ""
        unknown = [name for name in error.instance if name not in allowed]
        now = {name: MOVED_KEYS.get(f"{key}.{name}") for name in unknown}
        return [f"{key}.{name} is {now[name]} now" if now[name] else name_error(f"key{where}", name, allowed) for name in unknown]
    if error.validator in ("oneOf", "if"):
        return [line for cause in error.context or () for line in _explain(cause)]
    about = error.schema.get("description", "").split(". ")[0].rstrip(".")
    return [f"{key or 'the file'}: {error.message}" + (f" ({about})" if about else "")]
