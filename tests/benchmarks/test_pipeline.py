"""The benchmark of a whole mesh: stages are named by their commands, tables read what Snakemake measured, traces see where threads ran."""

import subprocess
import sys
import time

import psutil
import pytest

from helpers.benchmark_scripts import load_script

HEADER = "s\th:m:s\tmax_rss\tmax_vms\tmax_uss\tmax_pss\tio_in\tio_out\tmean_load\tcpu_time\n"


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


def test_jobs_of_a_rule_are_added_and_missing_figures_are_none(pipeline, tmp_path):
    for scene, row in (("a", "10\t0:00:10\t500\t0\t0\t0\t1\t2\t150\t15"), ("b", "2\t0:00:02\tNA\t-\t-\t-\tNA\tNA\tNA\tNA")):
        (tmp_path / scene / "benchmarks").mkdir(parents=True)
        (tmp_path / scene / "benchmarks/register.tsv").write_text(HEADER + row + "\n")
    (tmp_path / "a/benchmarks/capture.tsv").write_text(HEADER + "20\t0:00:20\t100\t0\t0\t0\t0\t0\t100\t20\n")
    capture, register = pipeline.read_stages(tmp_path)
    assert capture["stage"] == "capture"
    assert register == {
        "stage": "register", "jobs": 2, "wall_s": 12.0, "cpu_s": 15.0, "cores": 1.25, "memory_mb": 500, "read_mb": 1.0, "written_mb": 2.0,
    }  # fmt: skip


def test_a_trace_sees_what_a_process_and_its_children_did(pipeline, tmp_path):
    busy = "import time\nend = time.process_time() + 0.5\nwhile time.process_time() < end: pass"
    words = [sys.executable, "-c", f"import subprocess, sys; subprocess.run([sys.executable, '-c', {busy!r}])"]
    process, trace = subprocess.Popen(words), pipeline.Trace(sorted(psutil.Process().cpu_affinity()))
    while process.poll() is None:
        trace.sample(psutil.Process(process.pid))
        time.sleep(0.02)
    trace.finish()
    assert 0.3 < sum(trace.seconds.values()) < 5 and {stage for stage, _, _ in trace.seconds} == {"snakemake"}
    pipeline.draw(trace, tmp_path / "trace.png", "a test")
    assert (tmp_path / "trace.png").stat().st_size > 1000
