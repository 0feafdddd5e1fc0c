"""The benchmark of a whole mesh: stages are named by their commands, and traces see what they took and where their threads ran."""

import subprocess
import sys
import time

import psutil
import pytest

from helpers.benchmark_scripts import load_script


@pytest.fixture(scope="module")
def pipeline():
    yield from load_script("pipeline")


@pytest.mark.parametrize(
    ("words", "stage"),
    [
        (["python", "-m", "zeroshop_steps.register", "--method", "colmap", "--out", "x"], "register colmap"),
        (["python", "-m", "snakemake", "results/demo/mug/2dgs.ply"], "snakemake"),
    ],
)
def test_a_stage_is_named_by_its_command(pipeline, words, stage):
    assert pipeline.name_stage(words) == stage


def test_a_trace_sees_what_a_process_and_its_children_did(pipeline, tmp_path):
    busy = "import time\nend = time.process_time() + 0.5\nwhile time.process_time() < end: pass"
    words = [sys.executable, "-c", f"import subprocess, sys; subprocess.run([sys.executable, '-c', {busy!r}])"]
    process, trace = subprocess.Popen(words), pipeline.Trace(sorted(psutil.Process().cpu_affinity()))
    while process.poll() is None:
        trace.sample(psutil.Process(process.pid))
        time.sleep(0.02)
    trace.finish()
    assert 0.3 < sum(trace.seconds.values()) < 5 and {stage for stage, _, _ in trace.seconds} == {"snakemake"}
    (row,) = trace.list_stages()
    assert row["stage"] == "snakemake" and 0.4 < row["wall_s"] <= trace.wall_s + 0.1
    assert 0.3 < row["cpu_s"] < 5 and row["cores"] == pytest.approx(row["cpu_s"] / row["wall_s"], rel=0.3)
    assert row["memory_mb"] > 5
    table = pipeline.format_table(pipeline.COLUMNS, [row]).splitlines()
    assert table[0].startswith("| stage | wall_s") and table[2].startswith("| snakemake |")
    pipeline.draw(trace, tmp_path / "trace.png", "a test")
    assert (tmp_path / "trace.png").stat().st_size > 1000
