"""BlenderProc's environment: made by pip apart from this one, and what is said where it cannot be made."""

import pytest

from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.synthetic import blender_environment
from zeroshop_steps.synthetic.blender_environment import make_environment


@pytest.mark.slow
def test_an_environment_without_blender_is_made_and_not_taken_for_done(tmp_path, capfd, monkeypatch):
    """A list without packages makes an environment that lacks Blender."""
    monkeypatch.setattr(blender_environment, "find_spec", lambda name: None)
    (tmp_path / "packages.txt").write_text("# nothing\n")
    words = ["--method", "blender_environment", "--requirements", tmp_path / "packages.txt", "--folder", tmp_path / "environment"]
    assert stage_main("zeroshop_steps.synthetic", [*map(str, words), "--out", str(tmp_path / "record.json")]) == 1
    said = capfd.readouterr().err
    assert "lacks the module" in said and "renderer: raycast" in said
    assert (tmp_path / "environment/bin/python").exists() and not (tmp_path / "record.json").exists()


@pytest.mark.slow
def test_what_pip_cannot_install_is_said(tmp_path):
    (tmp_path / "packages.txt").write_text("--no-index\na-package-that-nobody-has==1.0\n")
    with pytest.raises(StepError, match="cannot install .*packages.txt: check the network"):
        make_environment(tmp_path / "packages.txt", tmp_path / "environment")


def test_no_list_and_no_python(tmp_path, monkeypatch):
    with pytest.raises(StepError, match="packages.txt does not exist"):
        make_environment(tmp_path / "packages.txt", tmp_path / "environment")
    (tmp_path / "packages.txt").touch()
    monkeypatch.setattr(blender_environment, "PYTHON", (3, 99))
    with pytest.raises(StepError, match="needs python3.99, which is not on the PATH"):
        make_environment(tmp_path / "packages.txt", tmp_path / "environment")


@pytest.mark.parametrize(
    ("tool", "words"),
    [("uv", "venv --seed --python 3.99"), ("micromamba", "create --yes --prefix FOLDER --channel conda-forge python=3.99")],
)
def test_a_python_that_is_absent_is_fetched_by_what_is_there(tmp_path, monkeypatch, tool, words):
    """A script stands for the tool: it notes what it is called with and leaves a Python that notes what pip is asked for."""
    folder, tools = tmp_path / "environment", tmp_path / "tools"
    tools.mkdir()
    script = f'#!/bin/sh\necho "$@" >> {tmp_path}/called\nmkdir -p {folder}/bin\n'
    script += f"printf '#!/bin/sh\\necho \"$@\" >> {tmp_path}/called\\n' > {folder}/bin/python\nchmod +x {folder}/bin/python\n"
    (tools / tool).write_text(script)
    (tools / tool).chmod(0o755)
    (tmp_path / "packages.txt").write_text("bpy\n")
    monkeypatch.setattr(blender_environment, "PYTHON", (3, 99))
    monkeypatch.setenv("PATH", f"{tools}:/usr/bin:/bin")
    assert make_environment(tmp_path / "packages.txt", folder) == folder / "bin/python"
    called = (tmp_path / "called").read_text().splitlines()
    assert called[0].startswith(words.replace("FOLDER", str(folder))) and called[1].startswith("-m pip install")
