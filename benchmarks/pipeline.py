"""Where the time of a mesh goes: one target of the workflow on 1, 2 and more cores, each run from scratch and pinned to its cores.

    python benchmarks/pipeline.py results/demo/mustard_bottle/2dgs.ply --out pipeline
    python benchmarks/pipeline.py results/photos/mouse/2dgs.ply --config objects_table=mine.tsv --out pipeline

A table of stages for each number of cores, by what Snakemake's benchmark files say: wall and CPU seconds, cores kept busy, largest memory
and megabytes read and written. And a picture of which stage kept which core busy when: every process of the run is asked five times a
second where its threads ran. A run that other work disturbs says so: the machine must be idle.
"""

import argparse
import csv
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
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
COLUMNS = ("stage", "jobs", "wall_s", "cpu_s", "cores", "memory_mb", "read_mb", "written_mb")


@dataclass
class Trace:
    """Which stage ran on which core: CPU seconds by (stage, core, number of the sample), and seconds of other processes."""

    cores: list[int]
    seconds: dict[tuple[str, int, int], float] = field(default_factory=lambda: defaultdict(float))
    samples: int = 0
    others_s: float = 0.0

    def __post_init__(self) -> None:
        self._ticks: dict[int, int] = {}
        self._idle = psutil.cpu_times(percpu=True)

    def sample(self, root: psutil.Process) -> None:
        """Add what each thread of a process and its children did since the last sample."""
        for process in [root, *_children(root)]:
            try:
                stage = name_stage(process.cmdline())
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
        """Note how much of these cores other processes took."""
        used = [sum(now) - now.idle - now.iowait - (sum(then) - then.idle - then.iowait) for now, then in
                zip(psutil.cpu_times(percpu=True), self._idle, strict=True)]  # fmt: skip
        self.others_s = max(sum(used[core] for core in self.cores) - sum(self.seconds.values()), 0.0)


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
    totals = []
    for count in sorted({count for count in args.cores if count <= len(there)}):
        with tempfile.TemporaryDirectory() as folder:
            run = measure(args.target, args.config, there[:count], Path(folder))
            if run is None:
                return 1
            wall_s, trace = run
            rows = read_stages(Path(folder))
        write_table(args.out / f"{count}.csv", rows)
        draw(trace, args.out / f"{count}.png", f"{args.target}, {count} cores")
        cpu_s = sum(trace.seconds.values())
        totals.append({"cores": count, "wall_s": round(wall_s, 1), "cpu_s": round(cpu_s, 1), "speed_up": 1.0})
        totals[-1]["speed_up"] = round(totals[0]["wall_s"] / wall_s, 2)
        print("\n".join(" | ".join(str(row[column]) for column in COLUMNS) for row in rows), totals[-1], sep="\n")
        if trace.others_s > BUSY_SHARE * count * wall_s:
            print(f"warning: other work took {trace.others_s:.0f} s of these cores: times are too long", file=sys.stderr)
    write_table(args.out / "all.csv", totals)
    return 0


def measure(target: str, config: list[str], cores: list[int], folder: Path) -> tuple[float, Trace] | None:
    """Make the target in an empty folder on these cores: wall seconds and the trace; None where it fails."""
    trace = Trace(cores)
    words = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "--cores", str(len(cores)), "--directory", str(folder)]
    words += [target, *(["--config", *config] if config else [])]
    start_s = time.monotonic()
    with (folder / "run.log").open("w") as log:
        process = subprocess.Popen(words, cwd=ROOT, stdout=log, stderr=log, preexec_fn=lambda: os.sched_setaffinity(0, cores))  # noqa: PLW1509
        known = psutil.Process(process.pid)
        while process.poll() is None:
            trace.sample(known)
            time.sleep(SAMPLE_S)
    wall_s = time.monotonic() - start_s
    trace.finish()
    if process.returncode:
        print(f"error: {target} could not be made:\n{(folder / 'run.log').read_text()[-3000:]}", file=sys.stderr)
        return None
    return wall_s, trace


def read_stages(folder: Path) -> list[dict[str, object]]:
    """A row of `COLUMNS` for each rule that ran, the longest first."""
    found = defaultdict(list)
    for path in folder.rglob("benchmarks/*.tsv"):
        with path.open(newline="") as file:
            found[path.stem].extend(csv.DictReader(file, delimiter="\t"))
    rows: list[dict[str, object]] = []
    for stage, jobs in found.items():
        sums = {name: sum(_number(job[name]) for job in jobs) for name in ("s", "cpu_time", "io_in", "io_out")}
        rows.append({
            "stage": stage, "jobs": len(jobs), "wall_s": round(sums["s"], 1), "cpu_s": round(sums["cpu_time"], 1),
            "cores": round(sums["cpu_time"] / max(sums["s"], 1e-9), 2), "memory_mb": round(max(_number(job["max_rss"]) for job in jobs)),
            "read_mb": round(sums["io_in"], 1), "written_mb": round(sums["io_out"], 1),
        })  # fmt: skip
    return sorted(rows, key=lambda row: -float(str(row["wall_s"])))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # a job that ended before it was asked has "-" or "NA"
        return 0.0


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
