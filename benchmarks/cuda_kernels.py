"""What the CUDA kernels become when they are compiled: registers, memory and double precision, for any card and without one.

The steps launch their kernels as always, on small scenes. Each launch is noted with the types of its arguments, then numba-cuda compiles it
for a compute capability, and NVIDIA's assembler says what it takes. Nothing is run, so this finds kernels that cannot be compiled and
kernels that spill registers, but no wrong result. Needs the extra `gpu`; prints why where it is absent.
"""

import argparse
import importlib.util
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

WARPS_BLOCKS_SHARED = {"8.0": (64, 32, 164), "8.6": (48, 16, 100), "8.9": (48, 24, 100), "9.0": (64, 32, 228), "12.0": (48, 24, 100)}
"""The most warps and blocks that a multiprocessor holds, and its shared memory in KiB, by compute capability (CUDA C++ Programming Guide,
Compute Capabilities). 8.0 is the A100, 8.9 the RTX 4070, 9.0 the H100 and H200."""
REGISTERS, REGISTERS_TOGETHER, WARP, SYSTEM_SHARED_BYTES = 65536, 8, 32, 1024
"""Of a multiprocessor; a thread gets a multiple of so many; threads of a warp; shared memory that a block takes for itself."""
DOUBLE = re.compile(r"^\s*(?:@%?!?\w+ )?(?:add|sub|mul|fma|div|sqrt|rcp|min|max|neg|abs|setp?)[.\w]*\.f64\b", re.MULTILINE)


@dataclass(frozen=True)
class Compiled:
    """What a kernel became.

    Attributes:
        name: module and function.
        threads: of a block.
        registers: of a thread.
        shared_bytes: of a block.
        stack_bytes: of local memory of a thread: arrays that do not fit into registers.
        spilled_bytes: that a thread stores since there are too few registers.
        double: instructions in double precision.
        occupancy: the share of the warps that a multiprocessor could hold for which there are registers, memory and blocks.
    """

    name: str
    threads: int
    registers: int
    shared_bytes: int
    stack_bytes: int
    spilled_bytes: int
    double: int
    occupancy: float


@dataclass(frozen=True)
class Launch:
    """A kernel, the types of the arguments it was launched with, and the threads of a block."""

    kernel: Any
    types: tuple
    threads: int


def find_what_is_missing() -> str | None:
    """What the extra `gpu` would bring and is absent, None if all is there."""
    if importlib.util.find_spec("numba_cuda") is None:
        return "numba-cuda"
    return None if find_assembler() else "NVIDIA's assembler (nvidia-cuda-nvcc)"


def find_assembler() -> Path | None:
    """ptxas, as NVIDIA's package brings it."""
    spec = importlib.util.find_spec("nvidia")
    found = [path for folder in (spec.submodule_search_locations or [] if spec else []) for path in Path(folder).glob("*/bin/ptxas")]
    return found[0] if found else None


class HostArray(np.ndarray):
    """An array in place of one on a device."""

    def copy_to_host(self) -> np.ndarray:
        return np.asarray(self)

    def copy_to_device(self, other: np.ndarray) -> None:
        self[...] = other


def note_launches(actions: list[Callable[[], object]]) -> dict[str, Launch]:
    """Kernels that actions launch, by name, with the types of their arguments. They do nothing."""
    from numba import cuda

    launches: dict[str, Launch] = {}

    def configure(kernel: Any, grid_and_block: tuple) -> Callable[..., None]:
        def launch(*arguments: Any) -> None:
            types = tuple(kernel.typeof_pyval(np.asarray(a) if isinstance(a, np.ndarray) else a) for a in arguments)
            name = f"{kernel.py_func.__module__.removeprefix('zeroshop_steps.')}.{kernel.py_func.__name__.strip('_')}"
            launches[name] = Launch(kernel, types, int(np.prod(grid_and_block[1])))

        return launch

    kernels = type(cuda.jit(lambda: None))
    with ExitStack() as stack:
        for target in ("runtime.compute.device_arrays.is_simulated", "runtime.compute.kernel_devices.has_cuda"):
            stack.enter_context(patch(f"zeroshop_steps.{target}", lambda: True))
        stack.enter_context(patch.object(kernels, "__getitem__", configure))
        stack.enter_context(patch.object(cuda, "to_device", lambda array: np.array(array).view(HostArray)))
        stack.enter_context(patch.object(cuda, "device_array_like", lambda array: np.zeros_like(array)))
        stack.enter_context(patch.object(cuda, "synchronize", lambda: None))
        for action in actions:
            action()
    return launches


def launch_all() -> dict[str, Launch]:
    """All kernels, as the steps launch them."""
    from scenes import ball_of_surfels, ball_of_voxels

    scenes = (ball_of_surfels("", 50, 32), ball_of_voxels("", 2, 32))
    return note_launches([*(lambda scene=scene: _train(scene) for scene in scenes), _search_planes, _draw_mesh, _color_texels])


def _train(scene: Any) -> None:
    scene = scene.on_device()
    planes = scene.render(scene.view(0))
    torch.autograd.backward(planes, [torch.ones_like(plane) for plane in planes])


def _search_planes() -> None:
    from zeroshop_steps.surface.mvs.patch_cost import NEIGHBOURS
    from zeroshop_steps.surface.mvs.patchmatch import make_patchmatch

    views, size = NEIGHBOURS + 1, 8
    color, masks = np.zeros((views, size, size, 3), np.float32), np.zeros((views, size, size), np.bool_)
    rows, sizes = np.zeros((views, 16)), np.full((views, 2), size)
    scene = (rows, np.zeros((views, NEIGHBOURS), np.int64), color, color[..., 0].copy(), masks, sizes)
    near = np.zeros((views, size, size), np.float32)
    search, all_views = make_patchmatch("cuda", scene, near, near + 1), range(views)
    search.initialize(all_views, 0)
    search.remember()
    search.recompute(all_views)
    search.refine(all_views, 0.5, 0, 0)


def _draw_mesh() -> None:
    from zeroshop_steps.geometry.rendering.rasterization import PixelGrid, draw_on_device

    pixels, depth, unit = torch.zeros(1, 3, 2), torch.ones(1, 3), torch.ones(1, 2)
    draw_on_device(pixels, depth, torch.zeros(1, 3, dtype=torch.int64), PixelGrid(unit, unit, 8, 8))


def _color_texels() -> None:
    from zeroshop_steps.finish.texturing.texel_colors import VotingView, make_texel_colors

    nothing, image = np.zeros((3, 3), np.float32), np.zeros((8, 8, 3), np.float32)
    colors = make_texel_colors("cuda", np.zeros((1, 3), np.int32), nothing[:1], np.zeros((3, 3)), 0.1)
    colors.begin_round(0.0, np.inf)
    colors.add(VotingView(np.zeros((3, 4)), image, image[..., 0].copy(), image[..., 0].copy(), nothing[0], nothing))
    colors.finish(nothing, 1.0)


def compile_launch(name: str, launch: Launch, capability: str) -> Compiled:
    """Compile a kernel for a compute capability, the same for all that a process compiles: the functions that they call are kept."""
    from numba import cuda
    from numba.cuda import dispatcher

    major, minor = map(int, capability.split("."))
    # The functions that a kernel calls are compiled for the current device, whatever the kernel is compiled for.
    with patch.object(dispatcher, "get_current_device", lambda: SimpleNamespace(compute_capability=(major, minor))):
        code, _ = cuda.compile_ptx(launch.kernel.py_func, launch.types, cc=(major, minor))
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "kernel.ptx"
        source.write_text(code)
        command = [str(find_assembler()), "-v", f"-arch=sm_{major}{minor}", str(source), "-o", str(source.with_suffix(".cubin"))]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stderr

    def read(pattern: str) -> int:
        return sum(map(int, re.findall(pattern, said)))

    registers, shared = read(r"Used (\d+) registers"), read(r"(\d+) bytes smem")
    return Compiled(
        name,
        launch.threads,
        registers,
        shared,
        read(r"(\d+) bytes stack frame"),
        read(r"(\d+) bytes spill stores"),
        len(DOUBLE.findall(code)),
        compute_occupancy(launch.threads, registers, shared, capability),
    )


def compute_occupancy(threads: int, registers: int, shared_bytes: int, capability: str) -> float:
    """The share of a multiprocessor's warps that blocks of this kind fill."""
    most_warps, most_blocks, shared_kib = WARPS_BLOCKS_SHARED[capability]
    warps = -(-threads // WARP)
    a_warp = -(-registers // REGISTERS_TOGETHER) * REGISTERS_TOGETHER * WARP
    by_registers, by_memory = REGISTERS // a_warp // warps, shared_kib * 1024 // (shared_bytes + SYSTEM_SHARED_BYTES)
    return warps * min(most_blocks, most_warps // warps, by_registers, by_memory) / most_warps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--capability", choices=WARPS_BLOCKS_SHARED, default="8.9", help="of the card (default: %(default)s)")
    capability = parser.parse_args().capability
    missing = find_what_is_missing()
    if missing:
        sys.exit(f"{missing} is absent; install the extra `gpu`: pip install -e '.[gpu]'. It compiles kernels without a card, too")
    row = "{:44}{:>9}{:>11}{:>10}{:>10}{:>10}{:>9}{:>11}"
    print(row.format(f"compute capability {capability}", "threads", "registers", "shared", "local", "spilled", "double", "occupancy"))
    for name, launch in launch_all().items():
        found = compile_launch(name, launch, capability)
        sizes = [f"{size} B" if size else "none" for size in (found.shared_bytes, found.stack_bytes, found.spilled_bytes)]
        print(row.format(name, found.threads, found.registers, *sizes, found.double, f"{found.occupancy:.0%}"), flush=True)


if __name__ == "__main__":
    main()
