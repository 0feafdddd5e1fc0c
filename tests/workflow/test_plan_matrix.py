"""What `snakemake -n` plans for slices of the matrix of scenes, registrations and surface methods."""

import pytest

from helpers.plans import able
from helpers.running import planned
from zeroshop_steps import methods

ALL_CELLS = 3 * able(methods.REGISTRATIONS) * able(methods.SURFACES)


def test_every_cell_of_the_matrix_has_a_path(snakemake):
    run = snakemake("-n", "results/demo/mustard_bottle/se/truth/2dgs/mesh.ply", "results/demo/mustard_bottle/su_l/colmap/2dgs/quality.csv")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["register"] == 2
    assert planned(run.stdout)["demo_model"] == 1


@pytest.mark.slow
def test_tables_cover_every_object(snakemake):
    run = snakemake("-n", "results/ycbv/tables/cameras.csv", "--config", "tables={registrations: [colmap]}")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["camera_error"] == 63


@pytest.mark.parametrize(
    ("target", "objects", "columns", "config"),
    [
        ("results/demo/mug/su_l/truth/2dgs/cell.csv", 1, 1, ()),
        ("results/demo/mug/cells.csv", 1, ALL_CELLS, ()),
        pytest.param("results/ycbv/tables/se/colmap/2dgs.csv", 21, 1, (), marks=pytest.mark.slow),
        pytest.param("results/demo/tables/reconstruction.csv", 11, ALL_CELLS, (), marks=pytest.mark.slow),
        pytest.param("results/demo/tables/reconstruction.md", 11, 3, ("registrations: [truth]", "nvs: [2dgs]"), marks=pytest.mark.slow),
    ],
)
def test_a_slice_of_the_matrix_plans_exactly_its_cells(snakemake, target, objects, columns, config):
    run = snakemake("-n", target, "--config", f"tables={{{', '.join(config)}}}")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert (jobs["cell"], jobs["evaluate"]) == (objects * columns,) * 2
    assert jobs["demo_model" if "demo" in target else "bop_model"] == objects


def test_methods_that_cannot_run_are_left_out_with_one_line_and_refused_by_name(snakemake):
    run = snakemake("-n", "results/demo/mug/cells.csv")
    lines = [line for line in run.stdout.splitlines() if "Left out of tables" in line]
    assert len(lines) == 1 and "mast3r lacks" in lines[0] and "vggt lacks" in lines[0]
    assert "su_h/mast3r/" not in run.stdout
    named = snakemake("-n", "results/demo/mug/cells.csv", "--config", "tables={registrations: [colmap, mast3r]}")
    assert named.returncode != 0
    assert "mast3r cannot run here, it lacks" in named.stdout and "Those that can: colmap, truth, auto." in named.stdout
    for part in ("CC BY-NC-SA 4.0", "https://download.europe.naverlabs.com/", "snakemake resources/weights/MASt3R", "need no weights"):
        assert part in named.stdout
    assert "Left out of tables: trellis lacks" in named.stdout
