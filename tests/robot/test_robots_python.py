"""What runs on a robot runs in its Python: ROS Noetic, as of the HSR, has 3.8."""

import ast

import pytest

from helpers.paths import REPOSITORY

OLDEST = (3, 8)
SINCE = {"removeprefix", "removesuffix", "pairwise", "zoneinfo", "tomllib", "batched"}
"""Names of later Pythons, methods and modules."""
GENERIC = {"list", "dict", "tuple", "set", "frozenset", "type"}
"""Whose subscripts, such as list[int], are later, too."""


def list_scripts():
    """The Python files of the ROS packages, by their first line or their ending."""
    files = [path for path in sorted((REPOSITORY / "ros").rglob("*")) if path.is_file()]
    return [path for path in files if path.suffix == ".py" or path.read_bytes().startswith(b"#!/usr/bin/env python3")]


def find_later(source: str) -> list[str]:
    """What of a source needs a later Python than `OLDEST`, as far as its syntax and names tell."""
    try:
        tree = ast.parse(source, feature_version=OLDEST)
    except SyntaxError as error:
        return [f"line {error.lineno}: {error.msg}"]
    found = []
    for node in ast.walk(tree):
        names = {getattr(node, "attr", ""), getattr(node, "id", ""), getattr(node, "module", "")}
        names |= {name.name for name in getattr(node, "names", []) if isinstance(name, ast.alias)}
        words = set(ast.unparse(node).split()) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr) else set()
        generic = isinstance(node, ast.Subscript) and getattr(node.value, "id", None) in GENERIC
        strict = isinstance(node, ast.Call) and getattr(node.func, "id", "") == "zip" and node.keywords
        if generic or strict or names & SINCE or words & {"None", "str", "int", "float"}:
            found.append(f"line {node.lineno}: {ast.unparse(node)}")
    return found


def test_scripts_of_the_ros_package_run_in_the_robots_python():
    scripts = list_scripts()
    assert [path.name for path in scripts] == ["recognize"]
    for path in scripts:
        assert find_later(path.read_text()) == [], path
        imported = {name.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Import) for name in node.names}
        assert not any(name.startswith("zeroshop") for name in imported), f"{path} runs without ZeroShOP"


@pytest.mark.parametrize(
    "source",
    [
        "match 1:\n    case 1: pass",
        "def f(a: list[int]): ...",
        "def f(a: int | None): ...",
        "'abc'.removeprefix('a')",
        "with (open('a') as a, open('b') as b): ...",
        "import tomllib",
        "zip('a', 'b', strict=True)",
    ],
)
def test_later_pythons_are_recognized(source):
    assert find_later(source)
