"""Measure the kernels of both optimizers on fixed scenes, and print rates and ratios (`make bench`).

Times are CPU time of one thread, the least of several repeats, for everything that an iteration of training pays: projection,
tile lists, blending, and gradients back to the parameters. They are divided by the samples blended: pairs of a pixel and a
primitive that adds to it. Operations of one such sample are counted by hand from the blending kernels alone:
an addition, a multiplication and a division count one each, a fused multiply-add two; comparisons and selections none.
Where there is a CUDA device, the same is measured there, as wall time.
"""

import argparse
import os

import numba
import torch

from count import blended_samples
from measure import Clock, Company, one_against_two_threads, peak_flops_per_second, peak_memory_mb, synchronised_seconds
from scenes import SurfelScene, VoxelScene, ball_of_surfels, ball_of_voxels, cloud_of_surfels
from zeroshop_steps.runtime.compute.device_arrays import choose_kernels

FLOPS = {"2dgs": (55, 115), "svraster": (185, 256)}
"""Operations of one blended sample, forward and backward."""

Scene = SurfelScene | VoxelScene


class Run:
    """Forward and backward of all views of a scene, and what they cost."""

    def __init__(self, scene: Scene, clock: Clock, render=None) -> None:
        self.scene, self.clock, self.render = scene, clock, render or scene.render
        self.views = [scene.view(index) for index in range(len(scene.cameras))]
        self.samples = sum(blended_samples(scene, view) for view in self.views)
        self.gradients = [torch.randn(plane.shape, generator=torch.Generator().manual_seed(0)) for plane in self.render(self.views[0])]

    def forward(self) -> list[list[torch.Tensor]]:
        return [self.render(view) for view in self.views]

    def backward(self, drawn: list[list[torch.Tensor]]) -> None:
        for planes in drawn:
            torch.autograd.backward(planes, self.gradients, inputs=self.scene.tensors)
        for tensor in self.scene.tensors:
            tensor.grad = None

    def both(self) -> None:
        self.backward(self.forward())

    def seconds(self, repeats: int) -> tuple[float, float]:
        """CPU seconds forward and backward."""
        self.both()
        forward = self.clock.cpu_seconds(self.forward, repeats)
        backward = float("inf")
        for _ in range(repeats):
            drawn = self.forward()
            backward = min(backward, self.clock.cpu_seconds(lambda drawn=drawn: self.backward(drawn)))
        return forward, backward


class DeviceRun(Run):
    """The same run on the CUDA device, with the samples and gradients of the one on the CPU."""

    def __init__(self, run: Run) -> None:
        self.scene, self.views, self.samples = run.scene.on_device(), run.views, run.samples
        self.render = self.scene.render
        self.gradients = [gradient.to(plane.device) for gradient, plane in zip(run.gradients, self.render(self.views[0]), strict=True)]

    def seconds(self, repeats: int) -> tuple[float, float]:
        """Wall seconds forward and backward, until the device is done; the first run, which compiles, does not count."""
        self.both()
        forward = backward = float("inf")
        for _ in range(repeats):
            drawn: list[list[torch.Tensor]] = []
            forward = min(forward, synchronised_seconds(lambda drawn=drawn: drawn.extend(self.forward())))
            backward = min(backward, synchronised_seconds(lambda drawn=drawn: self.backward(drawn)))
        return forward, backward


def sizes(quick: bool) -> list[Scene]:
    if quick:
        return [ball_of_surfels("small", 300, 24), ball_of_voxels("small", 2, 16)]
    return [
        ball_of_surfels("small", 1_000, 40),
        ball_of_surfels("coarse", 20_000, 160),
        ball_of_surfels("usual", 20_000, 320),
        ball_of_surfels("large", 80_000, 480),
        cloud_of_surfels("cloud", 15_000, 320),
        ball_of_voxels("small", 3, 24),
        ball_of_voxels("coarse", 7, 160),
        ball_of_voxels("usual", 7, 320),
        ball_of_voxels("large", 8, 480),
    ]


def growth(quick: bool) -> list[tuple[str, Scene, Scene]]:
    if quick:
        return [("2dgs, 4 x views", ball_of_surfels("", 300, 24), ball_of_surfels("", 300, 24, views=4))]
    surfels, voxels = ball_of_surfels("", 20_000, 160), ball_of_voxels("", 6, 160)
    return [
        ("2dgs, 4 x surfels", surfels, ball_of_surfels("", 80_000, 160)),
        ("2dgs, 4 x pixels", surfels, ball_of_surfels("", 20_000, 320)),
        ("2dgs, 4 x views", surfels, ball_of_surfels("", 20_000, 160, views=4)),
        ("svraster, 4 x voxels", voxels, ball_of_voxels("", 7, 160)),
        ("svraster, 4 x pixels", voxels, ball_of_voxels("", 6, 320)),
        ("svraster, 4 x views", voxels, ball_of_voxels("", 6, 160, views=4)),
    ]


COLUMNS = "{:18}{:>11}{:>9}{:>10}{:>9}{:>6}{:>6}{:>11}{:>10}{:>6}{:>9}{:>9}"


def print_sizes(scenes: list[Scene], clock: Clock, peak: float, repeats: int) -> list[tuple[Run, float]]:
    """Returns the runs, and the CPU seconds of each."""
    runs = []
    print(COLUMNS.format("", "", "", "", "ns a", "sample", "", "", "share of", "peak", "two", ""))
    names = ("primitives", "pixels", "samples", "forward", "back", "sum", "samples/s", "forward", "back", "threads", "memory")
    print(COLUMNS.format("", *names))
    for scene in scenes:
        run = Run(scene, clock)
        seconds = run.seconds(repeats)
        one, two = one_against_two_threads(run.both, repeats)
        memory = peak_memory_mb(run.both)
        nanoseconds = [1e9 * s / run.samples for s in (*seconds, sum(seconds))]
        shares = [100 * flops * run.samples / s / peak for flops, s in zip(FLOPS[scene.title], seconds, strict=True)]
        row = [f"{scene.title:9} {scene.name}", f"{len(scene):,}", f"{scene.cameras[0].width_px ** 2:,}", f"{run.samples / 1e6:.3f} M"]
        row += [f"{value:.1f}" for value in nanoseconds] + [f"{1e-6 * run.samples / sum(seconds):.1f} M"]
        row += [f"{share:.1f} %" for share in shares] + [f"{one / two:.2f} x", "unknown" if memory is None else f"{memory:.0f} MB"]
        print(COLUMNS.format(*row), flush=True)
        runs.append((run, sum(seconds)))
    return runs


def print_device(runs: list[tuple[Run, float]], repeats: int) -> None:
    if choose_kernels("auto") != "cuda":
        print("\nno CUDA device: Numba and PyTorch do not both find one, so nothing was measured on one")
        return
    print(
        f"\non {torch.cuda.get_device_name()}: ns of wall time a sample, forward and back; how often as fast as one thread of the CPU above"
    )
    for run, cpu_seconds in runs:
        seconds = DeviceRun(run).seconds(repeats)
        forward, backward = (1e9 * s / run.samples for s in seconds)
        print(f"  {run.scene.title:9} {run.scene.name:8}{forward:9.2f}{backward:9.2f}{cpu_seconds / sum(seconds):9.1f} x", flush=True)


def print_growth(pairs: list[tuple[str, Scene, Scene]], clock: Clock, repeats: int) -> None:
    print("\ngrowth, as ratios of CPU time (forward + backward) and of samples blended")
    for title, small, large in pairs:
        runs = Run(small, clock), Run(large, clock)
        seconds = [sum(run.seconds(repeats)) for run in runs]
        print(f"  {title:22}time x {seconds[1] / seconds[0]:<6.2f}samples x {runs[1].samples / runs[0].samples:.2f}")


def print_twins(scenes: list[Scene], clock: Clock) -> None:
    print("\nkernels against the float32 PyTorch twin, forward + backward, CPU time of one thread")
    for scene in scenes:
        if scene.name == "small":
            ours, theirs = (sum(Run(scene, clock, render).seconds(1)) for render in (scene.render, scene.twin))
            print(f"  {scene.title:9} {theirs / ours:.0f} times faster than the twin")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two tiny scenes once, to see that it works; its figures mean nothing")
    args = parser.parse_args()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    repeats = 1 if args.quick else 5
    clock, company = Clock(), Company()
    peak = peak_flops_per_second(clock)
    print(f"FP32 peak of one core, measured: {peak / 1e9:.0f} GFLOP/s; {os.cpu_count()} cores")
    print("operations of a blended sample, forward + backward: " + ", ".join(f"{k} {a} + {b}" for k, (a, b) in FLOPS.items()) + "\n")
    scenes = sizes(args.quick)
    print_device(print_sizes(scenes, clock, peak, repeats), repeats)
    print_growth(growth(args.quick), clock, repeats)
    print_twins(scenes, clock)
    waiting, others = clock.waiting_share(), company.others_cores()
    print(f"\nother processes used {others:.2f} cores; one thread waited {100 * waiting:.0f} % of its wall time")
    if waiting > 0.1 or others > 0.2 or (os.cpu_count() or 1) < 2:
        print("THE MACHINE WAS BUSY: the ratios of two threads mean nothing in this run; those of CPU time are too high by some")


if __name__ == "__main__":
    main()
