"""Every method is a command, and an error is one line."""

import importlib
import pkgutil
from pathlib import Path

import pytest

import zeroshop_steps
from zeroshop_steps.runtime.cli import stage_main, stage_methods

NO_STAGES = ("runtime", "geometry", "ros", "plan", "app")
STAGES = [found.name for found in pkgutil.iter_modules(zeroshop_steps.__path__) if found.ispkg and found.name not in NO_STAGES]


@pytest.mark.parametrize("stage", STAGES)
def test_every_method_of_a_stage_is_a_command(stage: str) -> None:
    methods = stage_methods(f"zeroshop_steps.{stage}")
    assert methods, "a stage without a method"
    for method in methods:
        module = importlib.import_module(f"zeroshop_steps.{stage}.{method}")
        assert callable(module.add_arguments) and callable(module.run) and module.__doc__


def test_an_unknown_method_lists_those_that_exist(capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as stop:
        stage_main("zeroshop_steps.surface", ["--method", "nerf"])
    assert stop.value.code == 2 and "twodgs" in capsys.readouterr().err


def test_a_step_error_is_one_line_and_status_one(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    arguments = ["--method", "fuse", "--model", f"{tmp_path}/none.ply", "--cameras", str(tmp_path), "--out", f"{tmp_path}/mesh.ply"]
    assert stage_main("zeroshop_steps.surface", arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and "none.ply does not exist" in error and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []
