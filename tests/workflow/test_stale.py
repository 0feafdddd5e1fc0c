"""Only what is stale runs again: what `snakemake -n` plans after each kind of change, on results that are all there."""

from collections import Counter

import pytest

from helpers.pretend import pretend
from helpers.running import planned, run_snakemake

pytestmark = pytest.mark.slow

CHOSEN, CELL, PHOTO = "results/demo/mug/2dgs.ply", "results/demo/mug/su_l/truth/2dgs/cell.csv", "results/photos/cup/2dgs.ply"
TARGETS = (CHOSEN, CELL, PHOTO)
VOXELS = CHOSEN.replace("2dgs", "svraster")
STAGES = ["register", "stereo", "train_2dgs", "fuse_2dgs", "shape", "texture"]
ENDS = {
    "chosen": ["evaluate", "publish"],
    "cell": ["evaluate", "cell"],
    "photo": ["evaluate_photos", "publish"],
}


def rerun(start, *which, **more):
    """The jobs by rule when these targets run again from a stage on, and some rules more."""
    stages = STAGES[STAGES.index(start) :]
    of_photos = [rule for stage in stages for rule in (["register_photos", "segment"] if stage == "register" else [stage])]
    rules = [rule for name in which for rule in (*(of_photos if name == "photo" else stages), *ENDS[name])]
    return {**Counter(rules), **more}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder in which all targets are made, with two photos of a cup, and the call of Snakemake in it."""
    folder = tmp_path_factory.mktemp("finished")
    for name in ("images", "masks"):
        (folder / "cup" / name).mkdir(parents=True)
        for photo in ("a.png", "b.png"):
            times = 100_000 if photo == "b.png" else 1  # over a megabyte
            (folder / "cup" / name / photo).write_text(f"{name} of {photo}" * times)
    table = folder / "objects.tsv"
    table.write_text(f"dataset\tobject\timages\tmasks\theight_m\nphotos\tcup\t{folder}/cup/images\t{folder}/cup/masks\t0.1\n")

    def snakemake(*arguments, config=()):
        return run_snakemake(folder, *arguments, "--config", f"objects_table={table}", *config)

    pretend(snakemake, folder, *TARGETS, VOXELS)
    return folder, snakemake


def stale(finished, *targets, config=()):
    """The planned jobs by rule."""
    run = finished[1]("-n", *targets, config=config)
    assert run.returncode == 0, run.stdout
    return planned(run.stdout)


def test_nothing_is_stale_at_first(finished):
    assert stale(finished, *TARGETS, VOXELS) == {}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        # The mug's model is no matter of chance, nor is the copy of the photos.
        ("seed=1", rerun("register", "chosen", "cell", "photo", capture_virtual=2)),
        ("capture={image_width_px: 640}", rerun("register", "chosen", "cell", capture_virtual=2)),
        ("capture={views_per_ring: 12}", rerun("register", "chosen", "cell", capture_virtual=2)),
        ("register={colmap: {max_features: 900}, auto: {max_features: 900}}", rerun("register", "chosen", "photo")),
        ("register={max_wrong_probability: 0.3}", rerun("register", "chosen", "photo")),
        ("nvs={2dgs: {train: {iterations: 900}}}", rerun("train_2dgs", "chosen", "cell", "photo")),
        ("nvs={2dgs: {fuse: {voxels: 99}}}", rerun("fuse_2dgs", "chosen", "cell", "photo")),
        ("finish={clean: {smooth: 2}}", rerun("shape", "chosen", "cell", "photo")),
        ("finish={texture_size_px: 128}", rerun("texture", "chosen", "cell", "photo")),
        ("finish={grade: {back_share: [0.03, 0.2]}}", {"evaluate": 2, "evaluate_photos": 1, "publish": 2, "cell": 1}),
        ("chosen={virtual: {scene: se}}", rerun("register", "chosen", capture_virtual=1)),
        ("tables={scenes: [se]}", {}),
    ],
)
def test_a_changed_choice_reruns_exactly_what_depends_on_it(finished, change, expected):
    assert stale(finished, *TARGETS, config=[change]) == expected


def test_a_changed_weight_of_svraster_reruns_its_training_and_what_follows_alone(finished):
    rules = ["train_svraster", "mesh_svraster", *STAGES[STAGES.index("shape") :], *ENDS["chosen"]]
    change = "nvs={svraster: {train: {lambda_normal: 0.123}}}"
    assert stale(finished, *TARGETS, VOXELS, config=[change]) == dict.fromkeys(rules, 1)


def test_a_changed_photo_reruns_its_own_product_alone(finished):
    photo = finished[0] / "cup/images/a.png"
    before = photo.read_text()
    try:
        photo.write_text("another picture")
        assert stale(finished, *TARGETS) == rerun("register", "photo", capture_photos=1)
        photo.write_text(before)
        assert stale(finished, *TARGETS) == {}, "the same bytes at a later time change nothing"
    finally:
        photo.write_text(before)


def test_a_large_photo_that_is_only_touched_changes_nothing(finished):
    """Snakemake's own limit is a megabyte, beyond which it goes by time."""
    (finished[0] / "cup/images/b.png").touch()
    assert stale(finished, *TARGETS) == {}


def test_a_new_photo_reruns_its_own_product_alone(finished):
    new = finished[0] / "cup/images/c.png"
    try:
        new.write_text("one more")
        assert stale(finished, *TARGETS) == rerun("register", "photo", capture_photos=1)
    finally:
        new.unlink()


def test_a_height_that_is_told_later_costs_no_reconstruction(finished):
    table = finished[0] / "objects.tsv"
    before = table.read_text()
    try:
        table.write_text(before.replace("0.1\n", "0.2\n"))
        assert stale(finished, *TARGETS) == rerun("shape", "photo")
    finally:
        table.write_text(before)


def test_a_new_scene_adds_its_own_cell_alone(finished):
    assert stale(finished, *TARGETS, CELL.replace("su_l", "se")) == rerun("register", "cell", capture_virtual=1)
