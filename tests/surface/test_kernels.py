"""Compiled kernels: the same code, and so the same bytes, whether it was compiled now or loaded, on any number of threads."""

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.checkout import folder_of_kernels
from helpers.paths import REPOSITORY
from zeroshop_steps.runtime.code_version import SOURCES

TRAINING = REPOSITORY / "tests/helpers/train_ball.py"


def train(kernels: Path, threads: int) -> str:
    """The digests of a short training in a process of its own, with a folder of compiled kernels."""
    paths = os.pathsep.join(map(str, (REPOSITORY / "src", REPOSITORY / "tests")))
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels), "NUMBA_NUM_THREADS": "2", "PYTHONPATH": paths}
    command = [sys.executable, str(TRAINING), str(threads)]
    return subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True, timeout=500).stdout


def compiled_in(kernels: Path) -> set[tuple[Path, int]]:
    """The files of compiled code in a folder, and when each was written."""
    return {(code, code.stat().st_mtime_ns) for code in kernels.rglob("*.nbc")}


@pytest.mark.slow
def test_kernels_compiled_now_or_loaded_give_the_same_bytes(tmp_path: Path) -> None:
    kernels, known = tmp_path / "kernels", os.environ.get("NUMBA_CACHE_DIR")
    if known and Path(known).is_dir():  # what this process compiled for other tests need not be compiled once more
        shutil.copytree(known, kernels)
    before = compiled_in(kernels)
    trained = train(kernels, 2)
    assert trained.count("\n") > 8
    if compiled_in(kernels) != before:
        assert train(kernels, 2) == trained, "all kernels loaded"
    folders = [kernels / folder_of_kernels(SOURCES / "surface" / part) for part in ("twodgs/kernels", "svraster/kernels", "training")]
    names = ("*.blend_*ward", "*.project_*ward", "ssim._*")
    large = [path for folder in folders for name in names for path in folder.glob(f"{name}-*.nbi")]
    # Kernels of sources as they were before are named alike but for the line.
    kinds = {(index.parent, index.name.split("-")[0]) for index in large}
    assert len(kinds) == 10, "forward and backward, of both optimizers, and two of the similarity"
    for index in large:
        index.unlink()
    assert train(kernels, 1) == trained, "the large kernels compiled now, what they call loaded, and on one thread"


def compiled_functions() -> Iterator[tuple[Path, ast.FunctionDef, dict[str, object]]]:
    """The functions that Numba compiles, with the options of their decorator that are literals."""
    for path in SOURCES.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            for decorator in node.decorator_list if isinstance(node, ast.FunctionDef) else ():
                if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) in ("numba.njit", "njit"):
                    options = {
                        word.arg: word.value.value for word in decorator.keywords if word.arg and isinstance(word.value, ast.Constant)
                    }
                    yield path, node, options


def test_what_a_kernel_calls_becomes_part_of_it() -> None:
    """Otherwise the linker takes the function from whichever library came first: compiled now or loaded, they differ in the last bits."""
    functions = list(compiled_functions())
    calls = [call.func for _, node, _ in functions for call in ast.walk(node) if isinstance(call, ast.Call)]
    called = {function.id for function in calls if isinstance(function, ast.Name)}
    inner = {"blend_splat", "differentiate_splat"}  # known to their callers by other names, one for each choice that they were made with
    loose = [
        f"{path.name}: {node.name}"
        for path, node, options in functions
        if node.name in called | inner and not options.get("forceinline") and options.get("inline") != "always"
    ]
    assert len(functions) > 60 and not loose
