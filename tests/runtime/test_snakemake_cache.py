"""Why results are not shared by Snakemake's own cache: each of its faults that runtime/cache.py names, shown on a tiny workflow."""

import os
import sys
from pathlib import Path

import pytest

from helpers.planner import call_snakemake

pytestmark = pytest.mark.slow

RULES = """
rule wildcard_in_shell:
    output: "shell/{object}.txt"
    cache: True
    shell: "echo {wildcards.object} > {output}"

rule made:
    output: "made/{object}.txt"
    shell: "echo {wildcards.object} > {output}"

rule made_input:
    input: "made/{object}.txt"
    output: "input/{object}.txt"
    cache: True
    shell: "cat {input} > {output}"

rule step:
    output: "step/{object}.txt"
    cache: True
    shell: "PYTHON step.py > {output}"
""".replace("PYTHON", sys.executable)


def snakemake(folder: Path, *targets: str) -> str:
    """Run Snakemake in `folder` with its own cache; what it said."""
    environment = {**os.environ, "SNAKEMAKE_OUTPUT_CACHE": str(folder / "shared"), "XDG_CACHE_HOME": str(folder / ".cache")}
    return call_snakemake(folder, ["--cores", "1", "--cache", "--", *targets], environment).stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A workflow that was run for object a, then given new code of its step, then run for object b."""
    folder = tmp_path_factory.mktemp("snakemake_cache")
    (folder / "Snakefile").write_text(RULES)
    (folder / "step.py").write_text("print('old code')\n")
    (folder / "shared").mkdir()
    snakemake(folder, "shell/a.txt", "input/a.txt", "step/a.txt")
    (folder / "step.py").write_text("print('new code')\n")
    snakemake(folder, "shell/b.txt", "input/b.txt", "step/b.txt", "made/b.txt")
    return folder


def test_a_rule_with_a_wildcard_in_its_command_is_given_another_objects_file(folder):
    assert (folder / "shell/a.txt").read_text() == "a\n"
    assert (folder / "shell/b.txt").read_text() == "a\n"


def test_a_rule_with_a_made_input_is_given_another_objects_file(folder):
    assert (folder / "made/b.txt").read_text() == "b\n"
    assert (folder / "input/b.txt").read_text() == "a\n"


def test_the_code_of_a_step_does_not_count(folder):
    assert (folder / "step/b.txt").read_text() == "old code\n"


def test_a_damaged_entry_is_used_and_a_result_is_a_link_to_it(folder):
    entry = (folder / "step/a.txt").resolve()
    assert entry.parent == folder / "shared"
    entry.write_text("old co")
    snakemake(folder, "step/c.txt")
    assert (folder / "step/c.txt").read_text() == "old co"


def test_a_rule_with_a_benchmark_may_not_take_part(tmp_path):
    rule = 'rule timed:\n    output: "a.txt"\n    benchmark: "a.tsv"\n    cache: True\n    shell: "touch {output}"\n'
    (tmp_path / "Snakefile").write_text(rule)
    (tmp_path / "shared").mkdir()
    assert "benchmark directive may not be marked as eligible" in " ".join(snakemake(tmp_path, "a.txt").split())
