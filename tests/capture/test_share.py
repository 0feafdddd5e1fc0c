"""A folder that two objects share: the same files, and nothing that makes one of them stale."""

import os

from zeroshop_steps.runtime.cli import stage_main


def test_files_are_shared_but_not_snakemakes_own(tmp_path):
    (tmp_path / "one/images").mkdir(parents=True)
    for name in ("images/0.png", "capture.json", ".snakemake_timestamp"):
        (tmp_path / "one" / name).write_text(name)
    assert (
        stage_main("zeroshop_steps.capture", ["--method", "share", "--folder", str(tmp_path / "one"), "--out", str(tmp_path / "two")]) == 0
    )
    shared = sorted(path.relative_to(tmp_path / "two").as_posix() for path in (tmp_path / "two").rglob("*") if path.is_file())
    assert shared == ["capture.json", "images/0.png"]
    assert os.path.samefile(tmp_path / "one/images/0.png", tmp_path / "two/images/0.png")
