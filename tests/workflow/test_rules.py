"""Every rule has what a user and a cluster need, and the lists that must agree do."""

import argparse
import importlib
import inspect
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from snakemake.api import SnakemakeApi
from snakemake.settings.types import ResourceSettings

from helpers.paths import REPOSITORY, SNAKEFILE
from zeroshop_steps.config_manual import KEYS, list_keys, read_sources, render_manual, resolve
from zeroshop_steps.synthetic.blender.start import BLENDERPROC_VERSION, BPY_VERSION
from zeroshop_steps.synthetic.demo_objects import list_demo_objects

STEPS_WITH_KEYS = [
    ("capture.video", ("video",)),
    ("segment.saliency", ("segment", "saliency")),
    ("segment.grounded_sam", ("segment", "grounded_sam")),
    ("register.aliked", ("register", "aliked")),
    ("register.auto", ("register", "auto")),
    ("register.mast3r", ("register", "mast3r")),
    ("surface.twodgs", ("nvs", "2dgs", "train")),
    ("surface.fuse", ("nvs", "2dgs", "fuse")),
    ("surface.svraster", ("nvs", "svraster", "train")),
    ("height.marker", ("height", "marker")),
    ("height.depth_camera", ("height", "depth_camera")),
    ("height.mast3r", ("height", "mast3r")),
    ("finish.shape", ("finish", "clean")),
    ("evaluate.finished_mesh", ("finish", "grade")),
    ("synthetic.make_test_scenes", ("bop", "test_set")),
]
"""Steps whose options are a part of the config, and where that is."""


@pytest.fixture(scope="module")
def rules(tmp_path_factory):
    """The rules by name, as Snakemake reads them, but for those that only name what they want."""
    with SnakemakeApi() as api:
        workflow = api.workflow(ResourceSettings(cores=1), snakefile=SNAKEFILE, workdir=tmp_path_factory.mktemp("rules"))._workflow
        yield {rule.name: rule for rule in workflow.rules if rule.output}


def locked() -> dict[str, str]:
    """The versions in requirements.lock by package, in lower case with dashes."""
    lines = (REPOSITORY / "requirements.lock").read_text().splitlines()
    pairs = (line.split("==") for line in lines if line and not line.startswith("#"))
    return {re.sub("[_.]", "-", name).lower(): version for name, version in pairs}


def test_a_rule_has_all_its_parts(rules):
    for name, rule in rules.items():
        assert len(rule.log) == 1 and rule.message, name
        assert str(rule.log[0]).replace("logs/", "benchmarks/").removesuffix(".log") + ".tsv" == str(rule.benchmark), name
        assert {"mem_mb", "runtime"} <= set(rule.resources), name
        assert rule.shellcmd.startswith("python -m zeroshop_steps.") and rule.shellcmd.endswith("> {log} 2>&1"), name


def test_a_rule_has_an_environment_that_is_there(rules):
    environments = {name: rule.expand_conda_env({}).file.get_path_or_uri(secret_free=True) for name, rule in rules.items()}
    assert {Path(path).name for path in environments.values()} == {"zeroshop.yaml", "blenderproc.yaml"}
    assert all(Path(path).is_file() for path in environments.values())
    assert [name for name, path in environments.items() if path.endswith("blenderproc.yaml")] == ["blender_environment"]


def test_nothing_is_written_outside_results_and_resources(rules):
    for name, rule in rules.items():
        paths = [*map(str, rule.output), *map(str, rule.log), str(rule.benchmark)]
        assert all(path.startswith(("results/", "resources/")) for path in paths), name


def test_what_a_config_says_is_no_derived_parameter(rules):
    """Snakemake does not record parameters by functions that take the input, so a change of the config behind them would be missed."""
    derived = {
        (name, key): param.__code__
        for name, rule in rules.items()
        for key, param in rule.params.items()
        if callable(param) and {"input", "output", "threads", "resources"} & set(inspect.signature(param).parameters)
    }
    assert len(derived) > 5
    assert [place for place, code in derived.items() if {"config", "settings"} & set(code.co_names)] == []


@pytest.mark.parametrize("name", ["capture_virtual", "register", "stereo", "train_2dgs", "train_svraster", "test_set"])
def test_a_long_step_is_told_its_threads(rules, name):
    assert rules[name].resources["_cores"] == 8 and "--threads {threads}" in rules[name].shellcmd


def test_there_are_rules(rules):
    assert {"demo_model", "bop_model", "capture_photos", "register", "train_2dgs", "texture", "publish"} <= set(rules)


def test_the_config_lists_every_demo_object():
    config = yaml.safe_load((REPOSITORY / "config" / "config.yaml").read_text())
    assert config["datasets"]["demo"]["objects"] == list_demo_objects()


@pytest.mark.parametrize(("module", "keys"), STEPS_WITH_KEYS)
def test_config_values_are_the_defaults_of_their_step(module, keys):
    options = yaml.safe_load((REPOSITORY / "config" / "config.yaml").read_text())
    for key in keys:
        options = options[key]
    parser = argparse.ArgumentParser()
    importlib.import_module(f"zeroshop_steps.{module}").add_arguments(parser)
    given = {key: value for key, value in options.items() if value is not None}  # null leaves an option to the step
    usual = {key: parser.get_default(key) for key in given}
    assert given == {key: list(value) if isinstance(value, tuple) else value for key, value in usual.items()}


@pytest.mark.parametrize(("module", "keys"), STEPS_WITH_KEYS)
def test_a_step_takes_what_the_schema_allows(module, keys):
    """The same choices and the same kind of number; limits of grades are pairs, which have neither."""
    schema, _ = read_sources()
    parser = argparse.ArgumentParser()
    importlib.import_module(f"zeroshop_steps.{module}").add_arguments(parser)
    actions = {action.dest: action for action in parser._actions}
    below = {path[-1]: resolve(node, schema) for path, node in list_keys(schema) if path[:-1] == keys}
    assert below, keys
    for name, node in below.items():
        action = actions[name]
        if "enum" in node or action.choices:
            assert set(action.choices or ()) == set(node.get("enum") or range(node["minimum"], node["maximum"] + 1)), name
        if node.get("type") in ("integer", "number"):
            assert action.type is {"integer": int, "number": float}[node["type"]], name


def test_the_list_of_keys_is_that_of_the_schema_and_the_defaults():
    assert KEYS.read_text() == render_manual(*read_sources()), "run: python -m zeroshop_steps.config_manual"


def test_every_key_is_described_and_its_choices_stand_in_the_comments():
    schema, _ = read_sources()
    text = (REPOSITORY / "config" / "config.yaml").read_text()
    for path, node in list_keys(schema):
        node = resolve(node, schema)
        assert len(node["description"]) > 10, path
        assert all(re.search(rf"\b{value}\b", text) for value in node.get("enum", ())), f"config.yaml does not name all that {path} may be"


def test_every_config_key_has_a_comment_and_stands_in_the_list_of_keys():
    lines = (REPOSITORY / "config" / "config.yaml").read_text().splitlines()
    listed = {name for path, _ in list_keys(read_sources()[0]) for name in path}
    datasets = yaml.safe_load("\n".join(lines))["datasets"]
    names = datasets["ycbv"]["names"]  # what users may say instead of a number
    for number, line in enumerate(lines):
        key = re.match(r"( *)([a-z0-9_]+):(.*)", line)
        if key is None or key[3].strip() == names.get(key[2]):
            continue
        indent, name, value = key.groups()
        assert name in listed or name in datasets, f"config/KEYS.md does not explain {name}"
        before = lines[number - 1].strip()
        is_first_of_its_parent = before.endswith(":") and not before.startswith("#")
        is_row_of_a_commented_group = bool(value.strip()) and re.match(rf"{indent}[a-z0-9_]+:", lines[number - 1])
        assert before.startswith("#") or is_first_of_its_parent or is_row_of_a_commented_group, f"config.yaml: {name} has no comment"


def test_the_lock_pins_every_dependency_and_names_no_place():
    text = (REPOSITORY / "requirements.lock").read_text()
    assert not re.search(r"://| @ |--hash|--index|/", text)
    project = (REPOSITORY / "pyproject.toml").read_text()
    extras = " ".join(re.findall(r"^(?:test|slurm|robot) = (.*)$", project, flags=re.M))
    declared = re.findall(r'^    "([a-z0-9-]+)"', project, flags=re.M) + re.findall(r'"([a-z-]+)"', extras)
    assert set(declared) <= set(locked()), "lock the new dependency: pip freeze in a clean environment"


def test_the_readers_are_locked_apart():
    text = (REPOSITORY / "requirements-readers.lock").read_text()
    names = {re.sub("[_.]", "-", line.split("==")[0]).lower() for line in text.splitlines() if not line.startswith("#")}
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    assert set(project["optional-dependencies"]["readers"]) <= names and not names & set(locked())


def test_the_conda_environment_has_the_locked_versions():
    environment = yaml.safe_load((REPOSITORY / "workflow" / "envs" / "zeroshop.yaml").read_text())
    pins = dict(pin.split("==") for pin in environment["dependencies"][-1]["pip"])
    assert pins.items() <= locked().items()
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    needed = {*project["dependencies"], *project["optional-dependencies"]["robot"]}
    assert needed - {"snakemake"} <= set(pins), "the steps run without Snakemake"


GPU_LOCK = REPOSITORY / "requirements-gpu.lock"


def test_what_a_gpu_needs_is_locked_for_the_cuda_of_the_locked_torch():
    pins = [line for line in GPU_LOCK.read_text().splitlines() if not line.startswith("#")]
    names = {re.split(r"[\[=]", pin)[0] for pin in pins}
    extras = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert {re.split(r"[\[=>]", need)[0] for need in (*extras["gpu"], *extras["drive"])} == names and not names & set(locked())
    assert any(pin.startswith("numba-cuda[cu13]==") for pin in pins), "PyTorch 2.13 is built for CUDA 13"
    assert "requirements-gpu.lock" in (REPOSITORY / "Makefile").read_text()


@pytest.mark.slow
def test_what_a_gpu_needs_resolves_beside_the_lock(tmp_path):
    """By pip's resolver and metadata of the index alone; nothing is installed."""
    shared = [f"{name}=={locked()[name]}" for name in ("torch", "numba", "numpy", "protobuf", "requests") if name in locked()]
    report = tmp_path / "report.json"
    words = ["--dry-run", "--ignore-installed", "--only-binary", ":all:", "--quiet", "--report", str(report), "-r", str(GPU_LOCK), *shared]
    run = subprocess.run([sys.executable, "-m", "pip", "install", *words], capture_output=True, text=True, timeout=500)
    if run.returncode and not re.search("ResolutionImpossible|conflicting dependencies", run.stderr):
        pytest.skip(f"the index does not answer: {run.stderr.strip().splitlines()[-1][:200]}")
    assert run.returncode == 0, run.stderr
    found = {item["metadata"]["name"].lower(): item["metadata"]["version"] for item in json.loads(report.read_text())["install"]}
    assert found["numba-cuda"] == "0.30.4" and found["torch"].split("+")[0] == locked()["torch"]
    assert tuple(map(int, found["cuda-bindings"].split(".")[:3])) >= (13, 0, 3), "what PyTorch for CUDA 13 wants"


def test_both_kinds_of_blender_environment_have_the_same_packages():
    environment = yaml.safe_load((REPOSITORY / "workflow" / "envs" / "blenderproc.yaml").read_text())
    lines = (REPOSITORY / "workflow" / "envs" / "blenderproc.txt").read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert environment["dependencies"][-1]["pip"] == pins
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9.]+", pin) for pin in pins)
    assert {f"bpy=={BPY_VERSION}", f"blenderproc=={BLENDERPROC_VERSION}"} <= set(pins)


def test_the_renderer_of_captures_has_the_defaults_of_its_step():
    capture = yaml.safe_load((REPOSITORY / "config" / "config.yaml").read_text())["capture"]
    for method in ("raycast", "blenderproc"):
        parser = argparse.ArgumentParser()
        importlib.import_module(f"zeroshop_steps.synthetic.{method}").add_arguments(parser)
        assert (capture["image_width_px"], capture["image_height_px"]) == (parser.get_default("width"), parser.get_default("height"))
    assert capture["samples"] == parser.get_default("samples")
