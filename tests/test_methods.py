"""A method that cannot run here is left out of "all" and refused where it is named, with what it lacks."""

import pytest

from zeroshop_steps import methods
from zeroshop_steps.methods import Method, lacks, left_out, refusal
from zeroshop_steps.runtime.cli import stage_methods
from zeroshop_steps.runtime.errors import StepError


def test_a_method_without_needs_can_run():
    assert lacks(methods.REGISTRATIONS["colmap"]) == [] and lacks(methods.SURFACES["2dgs"]) == []
    assert refusal("registration", "truth", methods.REGISTRATIONS) is None


def test_what_is_missing_is_named(tmp_path):
    learned = Method("register.colmap", weights=("a.pth", "b.pth", "c.pth"))
    (tmp_path / "resources/weights").mkdir(parents=True)
    (tmp_path / "resources/weights/b.pth").touch()
    assert lacks(learned, tmp_path) == ["the weights resources/weights/a.pth", "the weights resources/weights/c.pth"]
    table = {"colmap": Method("register.colmap"), "learned": learned}
    assert refusal("registration", "learned", table, tmp_path) == (
        "registration learned cannot run here, it lacks the weights resources/weights/a.pth and the weights resources/weights/c.pth."
        " Those that can: colmap."
    )
    line = left_out(table, root=tmp_path)
    assert line.startswith("Left out of tables: learned lacks the weights") and "\n" not in line
    (tmp_path / "resources/weights/a.pth").touch()
    (tmp_path / "resources/weights/c.pth").touch()
    assert lacks(learned, tmp_path) == []
    assert left_out({"learned": learned}, root=tmp_path) is None


def test_the_stages_have_their_methods():
    assert list(methods.REGISTRATIONS) == [
        "colmap",
        "truth",
        "aliked",
        "given",
        "mast3r",
        "da3",
        "da3_base",
        "vggt",
        "vggt_1024",
        "vggt_4096",
        "vggt_commercial",
        "auto",
    ]
    assert list(methods.SURFACES) == ["2dgs", "svraster", "trellis"]
    assert list(methods.SEGMENTATIONS) == ["grounded_sam", "saliency", "support_plane"]
    assert list(methods.DETECTORS) == ["contour", "cnos", "sam6d_ism"]
    assert set(methods.HEIGHTS) == {"known", "marker", "depth_camera", "given_cameras", "mast3r", "none"}
    assert list(methods.ESTIMATORS) == ["render_compare", "foundationpose", "foundationpose_onnx", "sam6d_pem"]


def test_every_method_is_a_step_of_its_stage():
    tables = (methods.REGISTRATIONS, methods.SEGMENTATIONS, methods.SURFACES, methods.HEIGHTS, methods.DETECTORS, methods.ESTIMATORS)
    for method in (method for table in tables for method in table.values()):
        stage, _, module = method.step.partition(".")
        known = stage_methods(f"zeroshop_steps.{stage}")
        assert module in known and (method.mesh is None or method.mesh in known)


@pytest.mark.parametrize(
    ("declared", "fault"),
    [
        ("{'weight': ()}", "METHOD must be a dictionary"),
        ("dict(rank=1)", "METHOD must be a dictionary"),
        ("{'name': 'other'}", "two methods of .* are called other"),
        ("{}\nPRESETS = {'large': {'weight': ()}}", "PRESETS must be a dictionary of such by name"),
        ("{}\nPRESETS = {'other': {}}", "two methods of .* are called other"),
    ],
)
def test_a_wrong_declaration_is_named(tmp_path, declared, fault):
    (tmp_path / "register").mkdir()
    (tmp_path / "register/other.py").write_text("\nMETHOD = {}\n")
    (tmp_path / "register/mine.py").write_text(f"\nMETHOD = {declared}\n")
    with pytest.raises(StepError, match=fault):
        methods.find_methods("register", tmp_path)


def test_a_preset_is_its_method_by_another_name(tmp_path):
    (tmp_path / "register").mkdir()
    rows = {"mine_large": {"weights": ("large.pth",), "title": "Large"}, "mine_slow": {"runtime_min": 90}}
    (tmp_path / "register/mine.py").write_text(f"\nMETHOD = {{'title': 'Mine', 'weights': ('small.pth',)}}\nPRESETS = {rows}\n")
    mine, large, slow = methods.find_methods("register", tmp_path).values()
    assert (large.step, large.name, large.title, large.weights, large.preset) == (mine.step, "mine_large", "Large", ("large.pth",), True)
    assert (slow.title, slow.weights, slow.runtime_min) == ("mine_slow", mine.weights, 90) and not mine.preset


def test_networks_that_the_config_names_are_looked_for():
    small = methods.SEGMENTATIONS["grounded_sam"].with_options({"detector": "grounding-dino-tiny", "tracker": "sam2.1-hiera-large"})
    assert "grounding-dino-tiny/model.safetensors" in small.files and "sam2.1-hiera-large/config.json" in small.files
    assert methods.REGISTRATIONS["mast3r"].with_options({"weights": "mine.pth"}).files == ()


def test_the_network_that_the_config_chooses_is_looked_for():
    method = Method("detect.mine", weights=("a.pth",), choices={"proposals": {"one": ("b.pth",), "other": ("c.pth", "d.pth")}})
    assert method.files == ("a.pth", "b.pth")
    assert method.with_options({"proposals": "other"}).files == ("a.pth", "c.pth", "d.pth")
