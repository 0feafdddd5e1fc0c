"""Photos with names that Snakemake cannot take are no inputs, but a changed one is noticed and the capture names those it leaves out."""

from pathlib import Path

import pytest

from faults.photos import name_in_latin_1, take_photos
from faults.plans import HEADER, TARGET, plan


@pytest.mark.slow
def test_braces_and_latin_1_in_the_names_of_photos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = take_photos(tmp_path)
    (photos / "0.jpg").rename(photos / "{brace}.jpg")
    name_in_latin_1(photos)
    (tmp_path / "objects.tsv").write_text(f"{HEADER}\nphotos\tthing\t{photos}\t\t0.1\t\n")
    assert plan(tmp_path, TARGET, "--config", f"objects_table={tmp_path / 'objects.tsv'}") == 0, capsys.readouterr().err
