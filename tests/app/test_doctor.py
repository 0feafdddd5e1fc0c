"""What a card can hold, by its free memory, and what is missing."""

import re

import pytest

from zeroshop_steps import methods
from zeroshop_steps.app.command import main
from zeroshop_steps.app.doctor import Need, foresee, list_missing


def test_a_card_of_12_gb_holds_every_network_of_the_thesis():
    free_gb = 11.3  # the desktop and CUDA take the rest
    assert {need.what: need.on(free_gb) for need in foresee() if need.on(free_gb) != "yes"} == {}
    assert any(need.on(6) == "no" for need in foresee())


@pytest.mark.parametrize(("free_gb", "word"), [(12, "yes"), (9, "in parts"), (6, "no")])
def test_a_need_is_met_wholly_in_parts_or_not(free_gb, word):
    assert Need("a network", 6.0, 10.0).on(free_gb) == word


def test_what_is_missing_is_named_with_its_remedy(tmp_path):
    lines = list_missing(tmp_path, lambda name: None)
    assert "the Python package numba_cuda: make gpu" in lines and "weights of trellis: snakemake weights/trellis" in lines
    for file in methods.SURFACES["trellis"].files:
        (tmp_path / "resources/weights" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "resources/weights" / file).touch()
    lines = list_missing(tmp_path, lambda name: object())
    assert not any("trellis" in line or "package" in line for line in lines) and "weights of mast3r: snakemake weights/mast3r" in lines


def test_the_command_says_what_a_card_can_run(monkeypatch, capsys):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert main(["doctor"]) == 0
    told = capsys.readouterr().out
    assert re.search(r"^needs     VGGT, .* GB\)$", told, re.MULTILINE)
    assert re.search(r"^no card   .*processor", told, re.MULTILINE) and "weights saliency/u2netp.onnx, for finding the object" in told
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda: (8_000_000_000, 12_000_000_000))
    monkeypatch.setattr("torch.cuda.get_device_name", lambda: "a card")
    assert main(["doctor"]) == 0
    told = capsys.readouterr().out
    assert "card      a card: 8.0 of 12.0 GB free" in told and "no        VGGT, full precision: cameras of 30 images (11.0 GB)" in told
    assert "in parts  VGGT, quarter precision: cameras of 20 images (7.6 GB to 9.9)" in told
