"""Changed code of a step makes its results stale, and those of no other step: what `snakemake -n` plans in a copy of the project."""

import pytest

from helpers.checkout import copy_checkout
from helpers.planner import call_snakemake
from helpers.pretend import pretend
from helpers.running import planned

pytestmark = pytest.mark.slow

PRODUCT = "results/demo/mug/2dgs.ply"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The sources of a copy of the project in which the mesh is made, and the jobs that are planned there."""
    folder = tmp_path_factory.mktemp("checkout")
    environment = copy_checkout(folder)

    def call(*words):
        return call_snakemake(folder, ["--snakefile", str(folder / "workflow/Snakefile"), "--cores", "2", *words], environment)

    pretend(call, folder, PRODUCT)

    def stale():
        run = call("-n", PRODUCT)
        assert run.returncode == 0, run.stdout
        return set(planned(run.stdout))

    return folder / "src/zeroshop_steps", stale


@pytest.mark.parametrize(
    ("module", "expected"),
    [
        ("evaluate/grade.py", {"evaluate", "publish"}),
        ("finish/texturing/charts.py", {"texture", "evaluate", "publish"}),
        ("height/known.py", {"shape", "texture", "evaluate", "publish"}),
        ("height/marker.py", set()),
        ("finish/publish.py", {"publish"}),
        ("segment/saliency.py", set()),
    ],
)
def test_a_changed_module_makes_what_runs_it_stale(finished, module, expected):
    sources, stale = finished
    before = (sources / module).read_text()
    try:
        (sources / module).write_text(f"# A comment, and a line of code that does nothing.\n{before}")
        assert stale() == set(), "comments do not count"
        (sources / module).write_text(f"{before}\nNOTHING = None\n")
        assert stale() == expected
    finally:
        (sources / module).write_text(before)
    assert stale() == set()
