"""What the measured stages start from, made once and stored: a capture, and the scene that a registration made of it.

INPUTS/KIND/NAME/ has capture/ and scene/, rendered ones model/, rendered films film/ as well. Delete a folder to have it made again.
"""

from pathlib import Path

from capture_benchmark.commands import last_line, run_step
from capture_benchmark.rendered import render, write_model
from capture_benchmark.table import Capture
from casual_captures.scene import DIFFICULTIES
from zeroshop_steps.networks.aliked import FOLDER
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.synthetic.film import render_film
from zeroshop_steps.synthetic.scenes.table_tops import TABLE_TOPS

SEED = 0
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm")


def find_inputs(inputs: Path, capture: Capture) -> Path:
    """The folder of a capture's inputs."""
    return inputs / capture.kind / capture.name


def make_inputs(capture: Capture, data: Path, inputs: Path, weights: Path, threads: int, with_scene: bool = True) -> None:
    """Make what is missing of a capture's inputs. A registration that refuses leaves its record in place of scene/.

    Args:
        capture: which.
        data: folder of real captures and of models.
        inputs: folder of all inputs.
        weights: folder of the networks that registration uses, those that are there.
        threads: how many threads may work.
        with_scene: whether the scene is needed, too.

    Raises:
        StepError: the data is missing, or a step fails without a reason of its own.
    """
    folder = find_inputs(inputs, capture)
    if capture.kind == "rendered":
        if capture.setting not in map(str, DIFFICULTIES):
            expected = ", ".join(map(str, DIFFICULTIES))
            raise StepError(f"{capture.name}: setting is {capture.setting!r}; expected a difficulty, one of {expected}")
        render(capture.path, int(capture.setting), data, folder, threads, with_scene)
        return
    source = data / capture.path
    if capture.kind == "film":
        if capture.setting not in TABLE_TOPS:
            raise StepError(f"{capture.name}: setting is {capture.setting!r}; expected a table, one of {', '.join(TABLE_TOPS)}")
        if not (folder / "model").is_dir():
            write_model(capture.path, data, folder / "model")
        if not (folder / "film").is_dir():
            render_film(folder / "model" / "model.ply", False, SEED, folder / "film", top=capture.setting)
        source = folder / "film" / "film.mp4"
    if not source.exists():
        raise StepError(f"{capture.name}: {source} does not exist; give the folder of the captures with --data, or correct the table")
    if with_scene and not (folder / "capture").is_dir():
        method = "video" if source.suffix.lower() in VIDEO_SUFFIXES else "photos"
        _run(["capture", "--method", method, "--images", source, "--out", folder / "capture"], folder / "logs/capture.log")
    if with_scene and not (folder / "scene").is_dir():
        words: list[str | Path] = ["register", "--method", "auto", "--capture", folder / "capture", "--scene", "video"]
        words += ["--out", folder / "scene", "--threads", str(threads), "--seed", str(SEED), "--record-failure", f"{folder / 'scene'}/"]
        network = weights / NETWORKS[DEFAULT].file
        words += ["--network", network] if network.is_file() else []
        _run([*words, "--weights", weights / FOLDER], folder / "logs/register.log")


def _run(words: list[str | Path], log: Path) -> None:
    if run_step(words, log).status:
        raise StepError(f"{words[0]} failed: {last_line(log)} (the log: {log})")
