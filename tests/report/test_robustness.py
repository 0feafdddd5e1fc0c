"""The table of robustness: a row per measurement, true models as a step of each kind of damage, and a plot."""

import pandas as pd

from zeroshop_steps.runtime.cli import stage_main


def gather(folder, runs):
    paths = []
    for name, value in runs.items():
        path = folder / f"results/demo/bop/render_compare-truth-{name}/scores.csv"
        path.parent.mkdir(parents=True)
        path.write_text(f"measure,object,value\nar,,{value}\nar_mssd,,0.5\nar,3,0.25\n")
        paths.append(str(path))
    words = ["--method", "robustness", "--out", str(folder / "robustness.csv"), "--scores", *paths]
    return stage_main("zeroshop_steps.report", words)


def test_every_step_of_every_damage_has_its_rows(tmp_path):
    runs = {"models": 0.9, "models_scaled_minus_10": 0.7, "models_scaled_plus_5": 0.8, "models_without_underside": 0.6}
    assert gather(tmp_path, runs) == 0
    table = pd.read_csv(tmp_path / "robustness.csv", dtype=str, na_filter=False)
    shown = table[(table.measure == "ar") & (table.object == "")]
    assert list(zip(shown.damage, shown.amount, shown.value, strict=True)) == [
        ("scale", "0 %", "0.9"), ("underside", "there", "0.9"), ("scale", "-10 %", "0.7"), ("scale", "+5 %", "0.8"),
        ("underside", "missing", "0.6"),
    ]  # fmt: skip
    assert set(table.estimator) == {"render_compare"} and len(table) == 15
    assert "average recall" in (tmp_path / "robustness.svg").read_text() and (tmp_path / "robustness.png").stat().st_size > 5000


def test_models_that_are_not_damaged_on_purpose_are_refused(tmp_path, capsys):
    assert gather(tmp_path, {"models_2dgs": 0.9}) == 1
    assert "models_2dgs names no damage" in capsys.readouterr().err and not (tmp_path / "robustness.csv").exists()
