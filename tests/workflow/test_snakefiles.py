"""The Snakefile at the top and workflow/Snakefile are one workflow: the same plan, profile and paths, from any folder."""

import os
import shutil

import pytest

from helpers.paths import REPOSITORY
from helpers.planner import call_snakemake
from helpers.running import planned

SNAKEFILES = ("Snakefile", "workflow/Snakefile")
TARGETS = ("results/demo/mug/su_h/vggt/2dgs/mesh.ply", "results/ycbv/bop/test", "resources/envs/blenderproc.json")


def bare(folder, *arguments):
    """What `snakemake` says when it is called in a folder with these arguments and no others."""
    run = call_snakemake(folder, list(map(str, arguments)), dict(os.environ))
    assert run.returncode == 0, run.stdout
    return run.stdout


def plan(output):
    """The jobs by rule, and their commands."""
    commands = {line.split("python -m ")[1] for line in output.splitlines() if "python -m zeroshop_steps." in line}
    assert len(commands) == sum(count for rule, count in planned(output).items() if rule != "all")
    return planned(output), commands


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """The project as a user clones it."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("workflow", "config", "src"):
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("*.egg-info", "__pycache__"))
    for name in ("Snakefile", "profiles"):
        shutil.copy2(REPOSITORY / name, folder / name, follow_symlinks=False)
    weights = folder / "resources/weights/VGGT-1B/model.safetensors"
    weights.parent.mkdir(parents=True)
    weights.touch()
    return folder


@pytest.fixture(scope="module")
def usual_jobs(checkout):
    """What a bare call in the project's folder plans for the targets."""
    return planned(bare(checkout, "-n", *TARGETS))


@pytest.mark.slow
def test_a_bare_call_takes_the_one_at_the_top_and_plans_what_the_other_plans(checkout):
    top, other = bare(checkout, "-n"), bare(checkout, "-n", "--snakefile", "workflow/Snakefile")
    assert f"Snakefile: {checkout}/Snakefile" in top and f"Snakefile: {checkout}/workflow/Snakefile" in other
    assert plan(top) == plan(other) and planned(top)["all"] == planned(top)["publish"] == 1
    for output in (top, other):
        assert "profiles/default for setting default command line arguments" in output
        assert f"Config file(s): ['{checkout}/config/config.yaml']" in output


@pytest.mark.slow
@pytest.mark.parametrize("snakefile", SNAKEFILES)
@pytest.mark.parametrize("profile", [None, "gpu", "slurm"])
def test_both_plan_the_same_in_another_folder(checkout, usual_jobs, tmp_path, snakefile, profile):
    (tmp_path / "resources").symlink_to(checkout / "resources")
    options = ["--workflow-profile", profile] if profile else []
    output = bare(tmp_path, "-n", "--snakefile", checkout / snakefile, "--directory", tmp_path, *options, *TARGETS)
    assert f"profiles/{profile or 'default'} for setting default command line arguments" in output
    jobs, commands = plan(output)
    assert jobs == usual_jobs
    [environment] = [command for command in commands if "blender_environment" in command]
    requirements = tmp_path / environment.split("--requirements ")[1].split()[0]
    assert requirements.resolve() == checkout / "workflow/envs/blenderproc.txt"


@pytest.mark.slow
@pytest.mark.parametrize("snakefile", SNAKEFILES)
def test_both_run_in_another_folder(checkout, tmp_path, snakefile):
    bare(tmp_path, "--snakefile", checkout / snakefile, "--directory", tmp_path, "results/demo/gelatin_carton/model")
    assert (tmp_path / "results/demo/gelatin_carton/model/model.ply").is_file()
    assert sorted(path.name for path in tmp_path.iterdir() if not path.name.startswith(".")) == ["results"]


@pytest.mark.slow
@pytest.mark.parametrize("snakefile", SNAKEFILES)
def test_snakemake_finds_nothing_to_mend_in_either(checkout, snakefile):
    assert "your workflow is in a good condition" in bare(checkout, "--lint", "--snakefile", snakefile)
