"""How the workflow refuses names and configs that do not exist, before anything runs."""

import pytest

from helpers.plans import photo_table
from helpers.quick import first

UNKNOWN = [
    ("results/demo/mustad_bottle/2dgs.ply", "unknown object of dataset demo: mustad_bottle. Did you mean mustard_bottle"),
    ("results/demoo/mustard_bottle/2dgs.ply", "unknown dataset: demoo. Did you mean demo? Known: demo, ycbv, photos"),
    ("results/demoo/mustard_bottle/su_h/colmap/2dgs/mesh.ply", "unknown dataset: demoo. Did you mean demo?"),
    ("results/demoo/mustard_bottle/su_h/colmap/2dgs/cell.csv", "unknown dataset: demoo. Did you mean demo?"),
    ("results/demo/mustard_bottle/su_x/capture", "unknown scene of a virtual dataset: su_x. Did you mean su_"),
    ("results/demo/bop/train_su_x", "unknown scene of a virtual dataset: su_x. Did you mean su_"),
    ("results/demo/mustard_bottle/3dgs.ply", "unknown nvs method: 3dgs. Did you mean 2dgs? Known: 2dgs, svraster"),
    ("results/demo/mustard_bottle/su_x/colmap/2dgs/mesh.ply", "unknown scene of a virtual dataset: su_x."),
    ("results/demo/mustard_bottle/su_h/colmp/2dgs/mesh.ply", "unknown registration of a virtual dataset: colmp. Did you mean colmap"),
    ("results/photos/cap/2dgs.ply", "unknown object of dataset photos: cap. Did you mean cup? Known: cup."),
    ("results/photos/cup/su_h/colmap/2dgs/mesh.ply", "unknown scene of a photo dataset: su_h. Known: video, video_segmented"),
    ("results/photos/cup/2dgs.ply", "the video or folder of its images, photos/of/nothing, does not exist"),
    ("results/photos/tables/reconstruction.csv", "unknown virtual dataset: photos"),
    ("results/ycbv/mustad_bottle/2dgs.ply", "unknown object of dataset ycbv: mustad_bottle. Did you mean mustard_bottle"),
    ("results/ycbv/mustard_bottle/cells.csv", "mustard_bottle is another name of obj_000005; ask for this file"),
    ("results/demo/mog/cells.csv", "unknown object of dataset demo: mog. Did you mean mug?"),
    ("results/demo/tables/su_q/colmap/2dgs.csv", "unknown scene of a virtual dataset: su_q. Did you mean su_"),
    ("results/demo/tables/su_h/colmop/2dgs.csv", "unknown registration of a virtual dataset: colmop. Did you mean colmap"),
    ("results/demo/tables/su_h/colmap/nerf.csv", "unknown nvs method: nerf. Known: 2dgs"),
    ("results/demo/mug/su_h/vggt/2dgs/mesh.ply", "registration of a virtual dataset vggt cannot run here, it lacks"),
]


@pytest.mark.parametrize(("target", "message"), first(8, UNKNOWN))
def test_an_unknown_name_in_a_target_lists_what_exists(snakemake, tmp_path, target, message):
    run = snakemake("-n", target, *photo_table(tmp_path, "photos/of/nothing", "masks/of/nothing"))
    assert run.returncode != 0
    assert message in run.stdout


BAD_CONFIGS = [
    ("finish={texture_size: 512}", "unknown key in finish: texture_size. Did you mean texture_size_px?"),
    ("sed=1", "unknown key: sed. Did you mean seed?"),
    ("seed=-1", "seed: -1 is less than the minimum of 0"),
    ("finish={texture_size_px: big}", "finish.texture_size_px: 'big' is not of type 'integer'"),
    ("chosen={virtual: {scene: su_x}}", "chosen.virtual.scene: 'su_x' is not one of ['su_l', 'su_h', 'se', 'su_f']"),
    ("datasets={mine: {kind: bob}}", "datasets.mine.kind: 'bob' is not one of"),
    ("datasets={mine: {kind: bop}}", "datasets.mine: 'models_folder' is a required property"),
    ("objects_table=no/such.tsv", "such.tsv does not exist"),
    ("tables={scenes: every}", "tables.scenes: 'all' was expected"),
    ("tables={nvs: [nerf]}", "tables.nvs.0: 'nerf' is not one of"),
]


@pytest.mark.parametrize(("config", "message"), first(4, BAD_CONFIGS))
def test_a_bad_config_names_the_key(snakemake, config, message):
    run = snakemake("-n", "--config", config)
    assert run.returncode != 0
    assert message in run.stdout
