"""The USD against NVIDIA's profile for props: it passes where it lies in a folder of its name and says when it was made."""

import ast
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.faults import step


def blocking_rules(asset: Path) -> set[str]:
    """The rules of required features that an asset fails, by their short names."""
    out = asset.parent / "report.json"
    command = [sys.executable, "-c", "import sys; from simready.validate._cli import main; sys.exit(main())"]
    words = [asset.name, "--profile", "Robotics-Prop", "--version", "3.1.0", "--output", out.name]
    subprocess.run([*command, *words], cwd=asset.parent, capture_output=True, text=True, check=False, timeout=300)
    [report] = json.loads(out.read_text()).values()
    failed = [feature for feature in report["features_summary"].values() if feature["blocking_failure"]]
    return {rule.rpartition("simready.")[2] for feature in failed for rule in ast.literal_eval(feature["failing requirements"])}


@pytest.mark.slow
def test_robotics_prop(box_folder, tmp_path):
    pytest.importorskip("simready.validate", reason="pip install -r requirements-readers.lock")
    folder = tmp_path / "2dgs" / "usd"
    folder.mkdir(parents=True)
    shutil.copytree(box_folder / "2dgs.body", folder / "2dgs.body")
    for date, failing in ({}, {"SR.001"}), ({"date": "2026-11-24"}, set()):
        assert step("assets", "usd", body=folder / "2dgs.body", out=folder / "2dgs.usda", **date) == 0
        assert blocking_rules(folder / "2dgs.usda") == failing
