"""A segmentation that fails is a result where it may be recorded, and an error otherwise."""

import pytest

from zeroshop_steps.register.scene.record import read_registration
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError


@pytest.mark.parametrize("method", ["user_masks", "support_plane"])
def test_the_reason_stands_in_place_of_the_masks(tmp_path, method, capsys):
    words = ["--method", method, "--scene", str(tmp_path / "scene"), "--out", str(tmp_path / "cameras")]
    assert stage_main("zeroshop_steps.segment", words) == 1
    assert not (tmp_path / "cameras").exists()
    assert stage_main("zeroshop_steps.segment", [*words, "--record-failure", f"{tmp_path}/cameras/"]) == 0
    with pytest.raises(StepError, match="run registration again"):
        read_registration(tmp_path / "cameras")
    assert [path.name for path in (tmp_path / "cameras").iterdir()] == ["failure.json"], "no masks"
    assert f"failed, recorded in {tmp_path}/cameras: segment.{method}: " in capsys.readouterr().err
