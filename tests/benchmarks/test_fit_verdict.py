"""The fit of the verdict on cameras, on strengths whose meaning is known."""

import json
from argparse import Namespace

import numpy as np
import pytest

from helpers.benchmark_scripts import load_script
from zeroshop_steps.register.verification.verdict import MEASURES


@pytest.fixture(scope="module")
def fitting():
    yield from load_script("fit_verdict")


def make_strengths(rng, count):
    """Models that the first measure tells right from wrong, and the second one says nothing about."""
    wrong = rng.random(count) < 0.4
    return np.stack([np.where(wrong, rng.normal(1.5, 0.4, count), rng.normal(0.5, 0.4, count)), rng.random(count)], 1).clip(0), wrong


def test_what_tells_weighs_and_what_does_not_loses_its_weight(fitting):
    strengths, wrong = make_strengths(np.random.default_rng(0), 400)
    *weights, offset = fitting.fit_logistic(strengths, wrong)
    assert weights[0] > 3 > 1 > weights[1] >= 0 and offset < 0
    probability = fitting.predict(strengths, np.array([*weights, offset]))
    assert ((probability > 0.5) == wrong).mean() > 0.85


def test_a_measure_that_no_model_had_keeps_the_common_weight(fitting):
    strengths, wrong = make_strengths(np.random.default_rng(1), 200)
    parameters = fitting.fit_logistic(np.column_stack([strengths, np.zeros(200)]), wrong)
    assert parameters[2] == pytest.approx(fitting.COMMON)


def test_a_fit_writes_the_weights_and_judges_the_other_half(fitting, tmp_path, monkeypatch, capsys):
    names = list(MEASURES)
    rng = np.random.default_rng(2)
    for name in ("mug", "bowl", "apple", "can", "box", "drill", "lamp", "plant"):
        strengths, wrong = make_strengths(rng, 20)
        rows = [
            {"mean_error": 0.1 * bad, "worst_error": 0.1 * bad, "strengths": dict(zip(names, row, strict=False))}
            for row, bad in zip(strengths.tolist(), wrong.tolist(), strict=True)
        ]
        (tmp_path / f"{name}_1.json").write_text(json.dumps(rows))
    monkeypatch.setattr(fitting, "WEIGHTS", tmp_path / "weights.txt")
    fitting.fit_verdict(Namespace(samples=tmp_path, half="tune"))
    stored = json.loads((tmp_path / "weights.txt").read_text())
    assert stored["weights"].keys() == MEASURES.keys() and stored["weights"][names[0]] > stored["weights"][names[1]]
    said = capsys.readouterr().out
    lines = said.splitlines()
    (equal,) = [line for line in lines if line.startswith("judged half, equal weights")]
    (fitted,) = [line for line in lines if line.startswith("judged half, fitted weights")]
    assert float(fitted.rpartition(" ")[2]) >= max(0.9, float(equal.rpartition(" ")[2]) - 0.02)
    loss = {line.partition(":")[0].strip(): float(line.partition("entropy ")[2].partition(";")[0]) for line in lines if "entropy" in line}
    assert loss[f"without {names[0]}"] > loss[f"without {names[1]}"] + 0.1


def test_every_second_capture_counts_as_a_film(fitting, tmp_path):
    row = {"strengths": {"error": 0.4}, "jump": 2.0}
    for number in (1, 2):
        (tmp_path / f"tea_box_{number}.json").write_text(json.dumps([row]))
    photos, film = fitting.read_samples(tmp_path)
    assert photos["object"] == film["object"] == "tea_box"
    assert "jump" not in photos["strengths"] and film["strengths"] == {"error": 0.4, "jump": 2.0}
