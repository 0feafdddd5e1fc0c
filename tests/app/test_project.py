"""An installed package brings the workflow along, and keeps weights in the user's cache."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from helpers.paths import REPOSITORY
from zeroshop_steps.app import project_folders
from zeroshop_steps.app.command import main
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.errors import StepError


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The wheel's files in a folder of their own."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, REPOSITORY]
    built = subprocess.run(command, capture_output=True, text=True)
    if built.returncode and "hatchling" in built.stderr:
        pytest.skip("the build backend cannot be downloaded here")
    assert built.returncode == 0, built.stderr
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def run_installed(installed: Path, folder: Path, *words: str) -> subprocess.CompletedProcess:
    """Python with the wheel's files in place of the clone's, in a folder."""
    program = "import sys; sys.path.insert(0, sys.argv.pop(1)); from zeroshop_steps.app.command import main; sys.exit(main(sys.argv[1:]))"
    environment = {**os.environ, "PYTHONPATH": str(installed), "XDG_CACHE_HOME": str(folder / "cache")}
    return subprocess.run(
        [sys.executable, "-c", program, str(installed), *words], cwd=folder, env=environment, capture_output=True, text=True
    )


@pytest.mark.slow
def test_the_wheel_plans_a_mesh_and_lays_out_a_project(installed, tmp_path):
    laid = run_installed(installed, tmp_path, "workflow", "init", "many")
    assert laid.returncode == 0, laid.stderr
    table = tmp_path / "many/objects.tsv"
    table.write_text(table.read_text() + "photos\tmug\tphotos\t\t0.096\n")
    for number in range(8):
        write_image(tmp_path / "many/photos" / f"{number}.png", np.full((60, 80, 3), 20 * number, np.uint8))
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    planned = subprocess.run(
        [sys.executable, "-m", "snakemake", "--cores", "2", "-n", "results/photos/mug/2dgs.ply", "results/demo/mustard_bottle/2dgs.ply"],
        cwd=tmp_path / "many", env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert planned.returncode == 0, planned.stdout + planned.stderr
    assert "train_2dgs" in planned.stdout and f"{REPOSITORY}/workflow" not in planned.stdout
    assert {path.name for path in (tmp_path / "many").iterdir()} <= {"Snakefile", "config.yaml", "objects.tsv", "photos", ".snakemake"}


def test_a_clone_keeps_its_weights(monkeypatch):
    assert project_folders.find_project() == REPOSITORY == project_folders.find_weights_home()
    monkeypatch.setattr(project_folders, "fetch_weights", lambda *_: pytest.fail("a clone downloads during its set-up alone"))
    project_folders.provide_weights()


@pytest.fixture
def cache(monkeypatch, tmp_path):
    """The user's cache of an installed package."""
    monkeypatch.setattr(project_folders, "PACKAGE", tmp_path / "site/zeroshop_steps")
    monkeypatch.setattr(project_folders, "user_cache_path", lambda name: tmp_path / "cache")
    (tmp_path / "site/zeroshop_steps/project/workflow").mkdir(parents=True)
    (tmp_path / "site/zeroshop_steps/project/workflow/Snakefile").touch()
    return tmp_path / "cache"


def test_an_installed_package_downloads_weights_once_into_the_users_cache(monkeypatch, cache, capsys):
    asked = []

    def fetch(name, path):
        asked.append(name)
        path.write_text("weights")

    monkeypatch.setattr(project_folders, "fetch_weights", fetch)
    project_folders.provide_weights()
    assert asked == ["saliency/u2netp.onnx", "mobile_sam.pt", "aliked/aliked-n16.pth", "aliked/aliked_lightglue.pth"]
    assert all((cache / "resources/weights" / name).is_file() for name in asked)
    assert str(cache) in capsys.readouterr().err
    project_folders.provide_weights()
    assert len(asked) == 4 and not capsys.readouterr().err


def test_without_a_network_a_warning_says_so_and_nothing_is_left(monkeypatch, cache, capsys):
    def fetch(name, path):
        raise StepError("no network.")

    monkeypatch.setattr(project_folders, "fetch_weights", fetch)
    project_folders.provide_weights()
    assert "warning: no network. Without these weights, objects on plain tables are refused more often" in capsys.readouterr().err
    assert not [path for path in cache.rglob("*") if path.is_file()]


def test_without_a_workflow_the_error_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(project_folders, "PACKAGE", tmp_path / "site/zeroshop_steps")
    with pytest.raises(StepError, match="install ZeroShOP again"):
        project_folders.find_project()


def test_a_project_is_not_laid_over_another(tmp_path, capsys):
    assert main(["workflow", "init", str(tmp_path / "new")]) == 0
    assert main(["workflow", "init", str(tmp_path / "new")]) == 1
    assert "has Snakefile and config.yaml and objects.tsv already" in capsys.readouterr().err
