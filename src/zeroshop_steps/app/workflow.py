"""Run the workflow for one file, showing how far it is instead of Snakemake's own report."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from snakemake_logger_plugin_zeroshop import EVENTS_FD
from zeroshop_steps.app.project_folders import find_project, find_weights_home
from zeroshop_steps.app.run_lock import free_dead_lock, note_run, remove_note
from zeroshop_steps.methods import BY_GIVEN_CAMERAS, REGISTRATIONS
from zeroshop_steps.networks.mobile_sam.choice import DEFAULT as DEFAULT_SEGMENTER
from zeroshop_steps.networks.mobile_sam.choice import find_segmenter
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS, NONE, find_network
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.plan.captures import JOINED_PHOTOS, WHOLE_SCENE
from zeroshop_steps.runtime.config_files import read_yaml, to_config_word
from zeroshop_steps.runtime.failures import IN_FOLDER, read_failure
from zeroshop_steps.runtime.files import read_json

TYPICAL_S = {
    "capture_photos": 2, "register_photos": 44, "segment": 13, "capture_object": 13, "stereo": 16, "train_2dgs": 25, "fuse_2dgs": 8,
    "train_svraster": 15, "mesh_svraster": 5, "shape": 21, "texture": 9, "evaluate_photos": 12, "publish": 1,
}  # fmt: skip
"""Seconds of each rule for 25 photos of 1558 x 1039 px on two cores: what the time left is estimated from, scaled to this run."""
OTHER_S = 3
MORE_FRAMES = 3
"""So many times as many frames are taken where those of a film have no sure cameras: distinct sides are merged where few
frames show the way from one to the other. A can with two like labels: 31 frames are refused, 52 of 60 are right."""
LEAST_MORE_FRAMES = 1.5  # times those before; fewer show little that is new


@dataclass
class Progress:
    """How far a run is, by the events of Snakemake (snakemake_logger_plugin_zeroshop).

    Attributes:
        planned: number of jobs, by rule.
        running: the rules of the jobs under way and what these say of themselves, by number.
        failed: the step that could not do its work, if there is one: all after it only pass that on.
    """

    planned: dict[str, int] = field(default_factory=dict)
    running: dict[int, tuple[str, str]] = field(default_factory=dict)
    started_s: float = field(default_factory=time.monotonic)
    total_s: float = 0.0
    done_s: float = 0.0
    failed: str = ""

    def read(self, event: Mapping[str, Any]) -> None:
        """Take one event."""
        if "planned" in event:
            self.planned = dict(event["planned"])
            self.total_s = self.done_s + sum(TYPICAL_S.get(rule, OTHER_S) * count for rule, count in self.planned.items())
        elif "job" in event:
            self.running[event["job"]] = event["rule"], event["says"]
        elif event["finished"] in self.running:
            rule, _ = self.running.pop(event["finished"])
            self.done_s += TYPICAL_S.get(rule, OTHER_S)

    @property
    def stages(self) -> list[str]:
        """What the jobs under way say of themselves."""
        return [says for _, says in self.running.values() if says]

    @property
    def share(self) -> float:
        """Share of the work that is done, 0 to 1."""
        return min(self.done_s / self.total_s, 1.0) if self.total_s else 0.0

    def describe(self) -> str:
        """One line: share, time left and what runs."""
        if self.failed:
            return f"{self.share:4.0%}   {self.failed} failed; the steps after it only note that"
        passed_s = time.monotonic() - self.started_s
        left = ""
        if self.share > 0.02:
            left_s = passed_s / self.share * (1 - self.share)
            left = f", about {left_s / 60:.0f} min left" if left_s > 90 else f", about {max(left_s, 1):.0f} s left"
        what = "; ".join(self.stages) or "planning"
        return f"{self.share:4.0%}{left}   {what}"


def _read_config() -> dict[str, Any]:
    return read_yaml(find_project() / "config/config.yaml")


def read_chosen_cell(settings: Mapping[str, Any], given_cameras: bool = False) -> tuple[str, str]:
    """The scene and the registration that the config chooses for photos, with these settings on top; or of given cameras."""
    chosen = _read_config()["chosen"]["photos"] | settings.get("chosen", {}).get("photos", {})
    return (WHOLE_SCENE, str(BY_GIVEN_CAMERAS)) if given_cameras else (chosen["scene"], chosen["registration"])


def settings_of_inputs(network: str | None) -> dict[str, Any]:
    """The settings that name the salient-object network, and the weights of learned features, where they are there.

    Downloaded weights lie in the clone or the user's cache, and the working directory may be another one.

    Args:
        network: name or ONNX file of the network that the user asked for, or NONE; by default the usual one, without which it also goes.

    Raises:
        StepError: the network that the user asked for is missing or damaged.
    """
    found = _find_network(network)
    segmenter = NONE if found == NONE else find_segmenter(DEFAULT_SEGMENTER, find_weights_home(), _say_where())
    settings: dict[str, Any] = {"segment": {"saliency": {"network": found, "segmenter": str(segmenter or NONE)}}}
    weights = [find_weights_home() / WEIGHTS_FOLDER / name for name in REGISTRATIONS["aliked"].weights]
    if all(path.is_file() for path in weights):
        settings["register"] = {"auto": {"weights": str(weights[0].parent)}}
    return settings


def _find_network(network: str | None) -> str:
    """The network as the config names it: an absolute file, or NONE."""
    if network == NONE:
        return NONE
    root, name = find_weights_home(), network or DEFAULT
    if name in NETWORKS:
        return str(find_network(name, bool(network), root, _say_where()) or NONE)
    return str(Path(name).resolve() if find_network(name, True) else NONE)


def _say_where() -> str:
    root = find_weights_home()
    return f" (call snakemake in {root})" if root == find_project() else "; zeroshop downloads it at the next run with a network"


def run_workflow(target: str, folder: Path, table: Path, cores: int, log: Path, settings: Mapping[str, Any] | None = None) -> bool:
    """Make `target` below `folder`; whether that went well. Everything that Snakemake says goes to `log`.

    Args:
        target: as Snakemake is asked for it, e.g. results/photos/mug/2dgs.ply.
        folder: the working directory.
        table: the table of objects, absolute.
        cores: processor cores that may be used.
        log: file for Snakemake's report.
        settings: of the config, in place of its own.
    """
    root = find_project()
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(root / "workflow/Snakefile")]
    command += ["--workflow-profile", str(root / "workflow/profiles/default"), "--directory", str(folder), "--cores", str(cores)]
    changed = [to_config_word(key, value) for key, value in {"objects_table": str(table), **(settings or {})}.items()]
    command += ["--config", *changed, "--nocolor", "--logger", "zeroshop"]
    progress = Progress()
    log.parent.mkdir(parents=True, exist_ok=True)
    if free_dead_lock(folder):
        print("The run before this one was cut off; going on where it stopped.", file=sys.stderr)
    events, writable = os.pipe()
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", EVENTS_FD: str(writable)}
    with (
        open(events) as lines,
        log.open("w") as file,
        subprocess.Popen([*command, "--", target], stdout=file, stderr=subprocess.STDOUT, pass_fds=[writable], env=environment) as process,
    ):
        os.close(writable)
        note_run(folder, process.pid)
        try:
            # One of several passes may fail and is left out: then the steps after it do run.
            single = read_chosen_cell(settings or {})[0] != JOINED_PHOTOS
            _show(progress, map(json.loads, lines), (folder / target).parent if single else None)
        except KeyboardInterrupt:
            process.send_signal(signal.SIGINT)
            process.wait()
            raise
    if process.returncode >= 0:
        remove_note(folder, process.pid)
    return process.returncode == 0


def count_more_frames(run: Path) -> int:
    """How many frames of a film to try next, as its cameras were refused; 0 where other things failed, or more hardly help.

    Args:
        run: the folder of its registration.
    """
    failure = read_failure(run / "scene")
    if not failure or not failure.step.startswith("register."):
        return 0
    film = read_json(run.parent / "capture/capture.json")
    taken, there = len(film.get("source_frames", [])), film.get("video_frames", 0)
    count = MORE_FRAMES * _read_config()["video"]["frames"]
    return count if LEAST_MORE_FRAMES * taken <= count <= there else 0


def find_failed_step(results: Path, since_s: float) -> str:
    """The step that failed, by a record below a folder since a time, in seconds as files have it; empty without any.

    Later steps pass the record on, so that each names the step that failed first.
    """
    failures = (read_failure(path.parent) for path in results.rglob(IN_FOLDER) if path.stat().st_mtime >= since_s)
    return next((failure.step for failure in failures if failure), "")


def _show(progress: Progress, events: Iterable[Mapping[str, Any]], results: Path | None) -> None:
    """Show the progress: one moving line on a terminal, a line a stage elsewhere."""
    console, since_s = Console(stderr=True), time.time()
    if console.is_terminal:
        with Live(Text("planning"), console=console, refresh_per_second=4) as live:
            for event in events:
                _take(event, progress, results, since_s)
                live.update(Text(progress.describe(), overflow="ellipsis", no_wrap=True))
        return
    last: Sequence[str] = ()
    for event in events:
        _take(event, progress, results, since_s)
        now = [progress.failed] if progress.failed else progress.stages
        if now and now != last:
            print(progress.describe(), file=sys.stderr, flush=True)
            last = now


def _take(event: Mapping[str, Any], progress: Progress, results: Path | None, since_s: float) -> None:
    progress.read(event)
    if results and not progress.failed and "finished" in event:
        progress.failed = find_failed_step(results, since_s)
