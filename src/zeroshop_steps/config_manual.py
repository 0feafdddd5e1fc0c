"""The list of config keys, config/KEYS.md, written from the schema and the defaults: `python -m zeroshop_steps.config_manual`.

The schema is where a key is described: its type, its range or choices, and what it means. A test says when the list is stale.
"""

import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from zeroshop_steps import methods
from zeroshop_steps.runtime.config_files import read_config_schema, read_yaml

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config/config.yaml"
SCHEMA = ROOT / "workflow/schemas/config.schema.yaml"
KEYS = ROOT / "config/KEYS.md"
LINE_CHARACTERS = 120
"""Of a line in the project's documents."""
SHOWN_ITEMS = 3
"""How many items of a default list are shown."""
HEAD = """# Keys of the config

Every key with its default, what else it may be, and what it means. This list is made from
`workflow/schemas/config.schema.yaml` and `config/config.yaml` by `python -m zeroshop_steps.config_manual`.
A star stands for all presets of a method.

Any other option of a step may stand in the section of that step, such as `register: {colmap: {min_share: 0.6}}` or
`nvs: {2dgs: {train: {lambda_dssim: 0.1}}}`. `python -m zeroshop_steps.surface --method twodgs --help` lists those of
training by 2DGS, and so on. `assets` has those of `assets --method body`, `finish.clean` those of `finish --method
shape`, `grasp` those of `grasp --method antipodal`, and `report.page` those of `report --method object_page`. A
`device` there comes before `devices`.

"""


def resolve(node: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """A part of the schema, with what its `$ref` names in place of that; a description of its own stays."""
    name = node.get("$ref", "").removeprefix("#/$defs/")
    return {**schema["$defs"][name], **{key: value for key, value in node.items() if key != "$ref"}} if name else node


def list_keys(schema: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    """The path of every key that has a value, with its part of the schema, in the schema's order.

    A dataset's name is NAME. A key that several kinds of datasets have comes once.
    """
    seen = set()
    for path, node in _walk((), schema, schema):
        if path not in seen:
            seen.add(path)
            yield path, node


def find_default(path: tuple[str, ...], config: Mapping[str, Any]) -> Any:
    """The value of a key in config.yaml.

    Raises:
        KeyError: it has none.
    """
    value: Any = config
    for name in path:
        value = value[name]
    return value


def describe_allowed(node: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """What a key may be: its choices, its range, or its type."""
    node = resolve(node, schema)
    if "enum" in node:
        return ", ".join(f"`{value}`" for value in node["enum"])
    if "if" in node:
        return "`all`, or a list of " + describe_allowed(node["else"]["items"], schema)
    types = node["type"] if isinstance(node["type"], list) else [node["type"]]
    numbers = resolve(node.get("items", {}), schema) if "array" in types else node
    low, high = numbers.get("minimum", numbers.get("exclusiveMinimum")), numbers.get("maximum")
    above = ">" if "exclusiveMinimum" in numbers else ""
    span = f"{above}{low}..{high}" if low is not None and high is not None else ""
    names = {"string": "text", "object": "mapping", "array": f"list of {span}" if span else "list"}
    if span:
        names |= {"integer": span, "number": span}
    return " or ".join(names.get(str(name), str(name)) for name in types)


def render_manual(schema: Mapping[str, Any], config: Mapping[str, Any]) -> str:
    """The whole Markdown text. What several methods of a stage have alike comes once, and so do choices that a description explains."""
    parts: list[str] = []
    room = ""
    alike: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for path, node in list_keys(schema):
        about, allowed = resolve(node, schema).get("description", "").rstrip("."), describe_allowed(node, schema)
        alike.setdefault((path[0], *path[2:], about, allowed) if len(path) > 2 else (*path, about, allowed), []).append(path)
    for (*_, about, allowed), paths in alike.items():
        if paths[0][0] != room:
            room = paths[0][0]
            parts.append(f"\n## {room}\n" if parts else f"## {room}\n")
        first, *others = _merge_presets([path[1] for path in paths if len(path) > 1]) or [""]
        key = f"`{'.'.join((room, first, *paths[0][2:]))}`" if first else f"`{room}`"
        key += f", {', '.join(f'`{name}`' for name in others)}" if others else ""
        default = "" if room == "datasets" else _show_defaults(paths, config)
        choices = re.findall("`.+?`", allowed)
        if choices and all(re.search(rf"\b{choice[1:-1]}\b", about) for choice in choices):
            known = default
        elif default in choices:
            known = ", ".join([default, *(choice for choice in choices if choice != default)])
        else:
            known = "; ".join(filter(None, (default, allowed)))
        line = f"- {key} ({known}): {about}." if known else f"- {key}: {about}."
        parts.append(textwrap.fill(line, LINE_CHARACTERS, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False))
    return HEAD + "\n".join(parts) + "\n"


def _merge_presets(names: Sequence[str]) -> list[str]:
    """Names of methods, those of a method and its presets as one with a star: vggt and vggt_1024 are vggt*."""
    found = [name for name in names if not any(name.startswith(f"{other}_") for other in names)]
    return [f"{name}*" if any(other.startswith(f"{name}_") for other in names) else name for name in found]


def _show_defaults(paths: Sequence[tuple[str, ...]], config: Mapping[str, Any]) -> str:
    """The default of the first key, and those of the others where they differ."""
    first, *others = (f"`{_show(find_default(path, config))}`" for path in paths)
    differing: dict[str, list[str]] = {}
    for path, default in zip(paths[1:], others, strict=True):
        if default != first:
            differing.setdefault(default, []).append(f"`{path[1]}`")
    texts = [f"{default} of {', '.join(names)}" for default, names in differing.items()]
    return f"{first} ({', '.join(texts)})" if texts else first


def read_sources() -> tuple[dict[str, Any], dict[str, Any]]:
    """The schema and the defaults of this checkout."""
    return read_config_schema(SCHEMA, methods.CHOICES, {}), read_yaml(CONFIG)


def _walk(path: tuple[str, ...], node: Mapping[str, Any], schema: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    node = resolve(node, schema)
    for name, child in node.get("properties", {}).items():
        below = resolve(child, schema)
        if "properties" in below or path + (name,) == ("datasets",):
            yield from _walk((*path, name), child, schema)
        elif "enum" in below or "description" in below:
            yield (*path, name), child
    if path == ("datasets",):
        yield from _walk((*path, "NAME"), node["additionalProperties"], schema)
        for case in node["additionalProperties"]["allOf"]:
            yield from _walk((*path, "NAME"), case["then"], schema)


def _show(value: Any) -> str:
    """A default, with a long list cut."""
    if isinstance(value, list) and len(value) > SHOWN_ITEMS:
        return f"[{', '.join(map(str, value[:SHOWN_ITEMS]))}, ...]"
    return json.dumps(value, ensure_ascii=False) if not isinstance(value, str) else value


def main() -> None:
    """Write config/KEYS.md."""
    KEYS.write_text(render_manual(*read_sources()))


if __name__ == "__main__":
    main()
