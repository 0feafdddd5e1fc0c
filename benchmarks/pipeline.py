"""Where the time of a mesh goes: one target of the workflow on 1, 2 and more cores, each run from scratch and pinned to its cores.

    python benchmarks/pipeline.py results/demo/mustard_bottle/2dgs.ply --out pipeline
    python benchmarks/pipeline.py results/photos/mouse/2dgs.ply --config objects_table=mine.tsv --out pipeline

A table of stages for each number of cores: wall and CPU seconds, cores kept busy, largest memory, and megabytes read from and written to
disk. And a picture of which stage kept which core busy when. Every process of the run is asked five times a second where its threads ran.
A run before these, which is not counted, compiles kernels. A run that other work disturbs says so: the machine must be idle.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib
import numpy as np
import psutil

from zeroshop_steps.runtime.tables import write_table

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
SAMPLE_S = 0.2
TICKS = os.sysconf("SC_CLK_TCK")
BUSY_SHARE = 0.1  # of a core that other processes may take on the way
STEP = "zeroshop_steps."
PROCESSOR, USER, SYSTEM = 36, 11, 12  # of the fields after the name in /proc/PID/task/TID/stat
COLUMNS = ("stage", "wall_s", "cpu_s", "cores", "memory_mb", "read_mb", "written_mb")
MEGABYTE = 1e6


@dataclass
class Trace:
    """What the stages of a run took.

    Attributes:
        cores: numbers of the cores that it ran on.
        seconds: of CPU time by (stage, core, number of the sample).
        memory_mb: resident, by (stage, number of the sample).
        transfers_mb: read from and written to disk, by (stage, number of the process), so far.
        others_s, wall_s: CPU seconds of other processes on these cores, and seconds of the run, once it has finished.
    """

    cores: list[int]
    seconds: dict[tuple[str, int, int], float] = field(default_factory=lambda: defaultdict(float))
    memory_mb: dict[tuple[str, int], float] = field(default_factory=lambda: defaultdict(float))
    transfers_mb: dict[tuple[str, int], tuple[float, float]] = field(default_factory=dict)
    samples: int = 0
    others_s: float = 0.0
    wall_s: float = 0.0

    def __post_init__(self) -> None:
        self._start_s = time.monotonic()
        self._ticks: dict[int, int] = {}
        self._idle = psutil.cpu_times(percpu=True)

    def sample(self, root: psutil.Process) -> None:
        """Add what each thread of a process and its children did since the last sample."""
        for process in [root, *_children(root)]:
            try:
                stage = name_stage(process.cmdline())
                self.memory_mb[stage, self.samples] += process.memory_info().rss / MEGABYTE
                transfers = process.io_counters()
                self.transfers_mb[stage, process.pid] = (transfers.read_bytes / MEGABYTE, transfers.write_bytes / MEGABYTE)
                for task in Path(f"/proc/{process.pid}/task").iterdir():
                    values = (task / "stat").read_text().rpartition(")")[2].split()
                    ticks = int(values[USER]) + int(values[SYSTEM])
                    before = self._ticks.get(int(task.name), 0)
                    self._ticks[int(task.name)] = ticks
                    if ticks > before:
                        self.seconds[stage, int(values[PROCESSOR]), self.samples] += (ticks - before) / TICKS
            except (psutil.Error, OSError):
                continue  # it ended in between
        self.samples += 1

    def finish(self) -> None:
        """Note how long it took, and how much of these cores other processes took."""
        self.wall_s = time.monotonic() - self._start_s
        used = [sum(now) - now.idle - now.iowait - (sum(then) - then.idle - then.iowait) for now, then in
                zip(psutil.cpu_times(percpu=True), self._idle, strict=True)]  # fmt: skip
        self.others_s = max(sum(used[core] for core in self.cores) - sum(self.seconds.values()), 0.0)

    def list_stages(self) -> list[dict[str, object]]:
        """A row of `COLUMNS` for each stage, the longest first."""
        rows: list[dict[str, object]] = []
        for stage in {stage for stage, _ in self.memory_mb}:
            memory_mb = [value for (name, _), value in self.memory_mb.items() if name == stage]
            wall_s = len(memory_mb) * self.wall_s / self.samples
            cpu_s = sum(value for (name, _, _), value in self.seconds.items() if name == stage)
            read_mb, written_mb = np.sum([value for (name, _), value in self.transfers_mb.items() if name == stage], axis=0)
            rows.append({
                "stage": stage, "wall_s": round(wall_s, 1), "cpu_s": round(cpu_s, 1), "cores": round(cpu_s / wall_s, 2),
                "memory_mb": round(max(memory_mb)), "read_mb": round(read_mb), "written_mb": round(written_mb),
            })  # fmt: skip
        return sorted(rows, key=lambda row: -float(str(row["wall_s"])))


def _children(process: psutil.Process) -> list[psutil.Process]:
    try:
        return process.children(recursive=True)
    except psutil.Error:
        return []


def name_stage(words: list[str]) -> str:
    """The stage of a process, by its command line: `register colmap`; the workflow itself and other commands by one name."""
    module = next((word for word in words if word.startswith(STEP)), "")
    if not module:
        return "snakemake"
    method = words[words.index("--method") + 1] if "--method" in words[:-1] else ""
    return f"{module.removeprefix(STEP)} {method}".strip()


def main() -> int:
    """Run the command line and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", help="as snakemake is asked for it")
    parser.add_argument("--cores", type=int, nargs="+", default=[1, 2, 4, 8], help="numbers of cores; what this machine lacks is left out")
    parser.add_argument("--config", nargs="+", default=[], metavar="KEY=VALUE", help="as of snakemake")
    parser.add_argument("--out", type=Path, required=True, help="folder to write: CORES.csv and CORES.png, and all.csv")
    args = parser.parse_args()
    there = sorted(os.sched_getaffinity(0))
    args.out.mkdir(parents=True, exist_ok=True)
    totals: list[dict[str, object]] = []
    counts = sorted({count for count in args.cores if count <= len(there)})
    for number, count in enumerate([counts[-1], *counts]):
        with tempfile.TemporaryDirectory() as folder:
            trace = measure(args.target, args.config, there[:count], Path(folder))
        if trace is None:
            return 1
        if number == 0:
            continue
        rows, cpu_s = trace.list_stages(), sum(trace.seconds.values())
        write_table(args.out / f"{count}.csv", rows)
        draw(trace, args.out / f"{count}.png", f"{args.target}, {count} cores")
        speed_up = (float(str(totals[0]["wall_s"])) if totals else trace.wall_s) / trace.wall_s
        totals.append({"cores": count, "wall_s": round(trace.wall_s, 1), "cpu_s": round(cpu_s, 1), "speed_up": round(speed_up, 2)})
        print(
            f"\n{args.target}, {count} cores\n\n{format_table(COLUMNS, rows)}\n\n{format_table(tuple(totals[-1]), totals[-1:])}", flush=True
        )
        if trace.others_s > BUSY_SHARE * count * trace.wall_s:
            print(f"warning: other work took {trace.others_s:.0f} s of these cores: times are too long", file=sys.stderr)
    write_table(args.out / "all.csv", totals)
    return 0


def format_table(columns: Sequence[str], rows: list[dict[str, object]]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *([row[column] for column in columns] for row in rows)]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def measure(target: str, config: list[str], cores: list[int], folder: Path) -> Trace | None:
    """Make the target in an empty folder on these cores; None where it fails."""
    trace = Trace(cores)
    words = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "--cores", str(len(cores)), "--directory", str(folder)]
    words += [target, *(["--config", *config] if config else [])]
    with (folder / "run.log").open("w") as log:
        process = subprocess.Popen(words, cwd=ROOT, stdout=log, stderr=log, preexec_fn=lambda: os.sched_setaffinity(0, cores))  # noqa: PLW1509
        known = psutil.Process(process.pid)
        while process.poll() is None:
            trace.sample(known)
            time.sleep(SAMPLE_S)
    trace.finish()
    if process.returncode:
        print(f"error: {target} could not be made:\n{(folder / 'run.log').read_text()[-3000:]}", file=sys.stderr)
        return None
    return trace


def draw(trace: Trace, path: Path, title: str) -> None:
    """A strip for each core, coloured by the stage that kept it busiest, in seconds of the run."""
    busy: dict[str, float] = defaultdict(float)
    for (stage, _, _), seconds in trace.seconds.items():
        busy[stage] += seconds
    stages = sorted(busy, key=lambda stage: -busy[stage])
    colors = plt.get_cmap("tab20")(np.arange(len(stages)) % 20)
    figure, axes = plt.subplots(figsize=(12, 1.2 + 0.5 * len(trace.cores) + 0.12 * len(stages)))
    for (stage, core, number), seconds in trace.seconds.items():
        if core in trace.cores:
            share = min(seconds / SAMPLE_S, 1.0)
            axes.bar(number * SAMPLE_S, share, SAMPLE_S, trace.cores.index(core), align="edge", color=colors[stages.index(stage)])
    axes.set(title=title, xlabel="seconds", ylabel="core", yticks=np.arange(len(trace.cores)) + 0.5, yticklabels=trace.cores)
    handles = [plt.Rectangle((0, 0), 1, 1, color=color) for color in colors]
    figure.legend(handles, stages, loc="lower center", ncols=6, fontsize=7)
    figure.tight_layout(rect=(0, 0.04 + 0.02 * np.ceil(len(stages) / 6), 1, 1))
    temporary = path.with_suffix(".part.png")
    figure.savefig(temporary, dpi=110)
    plt.close(figure)
    shutil.move(temporary, path)


if __name__ == "__main__":
    sys.exit(main())
