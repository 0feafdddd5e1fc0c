"""The list of config keys, config/KEYS.md, written from the schema and the defaults: `python -m zeroshop_steps.config_manual`.

The schema is where a key is described: its type, its range or choices, and what it means. A test says when the list is stale.
"""

import json
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

Every key with its default, what it may be, and what it means. [The manual](README.md#keys) says when to change one.
This list is made from `workflow/schemas/config.schema.yaml` and `config/config.yaml` by
`python -m zeroshop_steps.config_manual`. Change those, not this page.

"""


def resolve(node: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """A part of the schema, with what its `$ref` names in place of that."""
    name = node.get("$ref", "").removeprefix("#/$defs/")
    return schema["$defs"][name] if name else node


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
    """What a key may be, in words: its choices, or its type and range."""
    node = resolve(node, schema)
    if "enum" in node:
        return "one of " + ", ".join(f"`{value}`" for value in node["enum"])
    if "if" in node:
        return "`all`, or a list with any of" + describe_allowed(node["else"]["items"], schema).removeprefix("one of")
    types = node["type"] if isinstance(node["type"], list) else [node["type"]]
    count = {2: " of two numbers", 3: " of three numbers"}.get(node.get("minItems", 0), " of numbers")
    names = {"string": "text", "integer": "whole number", "array": f"list{count}", "object": "mapping"}
    words = " or ".join(names.get(str(name), str(name)) for name in types)
    numbers = resolve(node.get("items", {}), schema) if "array" in types else node
    low, high = numbers.get("minimum", numbers.get("exclusiveMinimum")), numbers.get("maximum")
    if low is None or high is None:
        return words.replace(count, "")
    above = "above " if "exclusiveMinimum" in numbers else ""
    return f"{words}, {above}{low} to {high}"


def render_manual(schema: Mapping[str, Any], config: Mapping[str, Any]) -> str:
    """The whole Markdown text. What several methods of a stage have alike comes once."""
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
        others = ", ".join(f"`{path[1]}`" for path in paths[1:])
        key = f"`{'.'.join(paths[0])}`" + (f" (also of {others})" if others else "")
        default = "" if room == "datasets" else f", default {_show_defaults(paths, config)}"
        line = f"- {key}: {about}. {allowed[0].upper()}{allowed[1:]}{default}."
        parts.append(textwrap.fill(line, LINE_CHARACTERS, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False))
    return HEAD + "\n".join(parts) + "\n"


def _show_defaults(paths: Sequence[tuple[str, ...]], config: Mapping[str, Any]) -> str:
    """The default of the first key, and those of the others where they differ."""
    first, *others = (f"`{_show(find_default(path, config))}`" for path in paths)
    differing = [f"{default} of `{path[1]}`" for path, default in zip(paths[1:], others, strict=True) if default != first]
    return f"{first} ({', '.join(differing)})" if differing else first


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
