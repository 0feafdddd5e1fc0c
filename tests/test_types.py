"""Every function says its types, but for those that numba compiles, which mypy is told to let pass."""

import ast

from helpers.paths import REPOSITORY

COMPILERS = {"njit", "jit", "vectorize", "guvectorize"}


def is_compiled(function: ast.FunctionDef) -> bool:
    """Whether one of its decorators is numba's."""
    names = (decorator.func if isinstance(decorator, ast.Call) else decorator for decorator in function.decorator_list)
    return any((name.attr if isinstance(name, ast.Attribute) else getattr(name, "id", "")) in COMPILERS for name in names)


def lacks_types(function: ast.FunctionDef) -> bool:
    """Whether its result, or an argument other than `self` or `cls`, has no annotation."""
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, *filter(None, (arguments.vararg, arguments.kwarg))]
    bare = [argument.arg for argument in named if argument.annotation is None]
    return function.returns is None or any(name not in ("self", "cls") for name in bare)


def test_only_compiled_functions_have_no_types():
    found = []
    for path in sorted((REPOSITORY / "src").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and not is_compiled(node) and lacks_types(node):
                found.append(f"{path.relative_to(REPOSITORY)}:{node.lineno} {node.name}")
    assert not found, "\n".join(found)
