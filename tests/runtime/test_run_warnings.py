"""Warnings of a run's logs are repeated at its end; those of earlier runs are not."""

import os

import cv2
import numpy as np
import pytest

from helpers.running import run_snakemake
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.runtime.run_warnings import SHOWN, failures_since, repeat_warnings, warnings_since


def log_of(folder, name, *lines, age_s=0.0):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    os.utime(path, (1e9 - age_s,) * 2)


def test_warnings_of_this_run_are_found(tmp_path):
    log_of(tmp_path, "photos/cup/video/logs/capture.log", "one", "warning: blurred: a.jpg", "two warning: no")
    log_of(tmp_path, "photos/cup/logs/old.log", "warning: of yesterday", age_s=60.0)
    log_of(tmp_path, "photos/cup/video/capture/images/logs/x.log", "warning: a picture")
    assert warnings_since(tmp_path, 1e9 - 1) == [f"{tmp_path}/photos/cup/video/logs/capture.log: blurred: a.jpg"]
    assert warnings_since(tmp_path / "absent", 0.0) == []


def test_they_are_said_as_steps_say_them(tmp_path, capsys):
    repeat_warnings(tmp_path, 0.0)
    assert capsys.readouterr().err == ""
    for number in range(SHOWN + 2):
        warn(f"w{number}.")
    log_of(tmp_path, "a/logs/b.log", *capsys.readouterr().err.splitlines())
    repeat_warnings(tmp_path, 0.0)
    said = capsys.readouterr().err
    assert f"Warnings ({SHOWN + 2})" in said and "b.log: w0." in said and "and 2 more" in said and "w31." not in said


def test_a_failure_is_told_once_however_many_steps_passed_it_on(tmp_path, capsys):
    first, second = (f"failed, recorded in results/{name}/raw_mesh.ply: surface.fuse: no surface" for name in ("cup", "mug"))
    log_of(tmp_path, "cup/logs/fuse.log", first)
    log_of(tmp_path, "cup/logs/clean.log", first)
    log_of(tmp_path, "mug/logs/clean.log", second)
    log_of(tmp_path, "jug/logs/fuse.log", first.replace("cup", "jug"), age_s=60.0)
    assert failures_since(tmp_path, 1e9 - 1) == [line.removeprefix("failed, recorded in ") for line in (first, second)]
    repeat_warnings(tmp_path, 1e9 - 1)
    said = capsys.readouterr().err
    assert "recorded in place of results (2):" in said and "results/cup/raw_mesh.ply: surface.fuse: no surface" in said
    assert "--forcerun" in said and "Warnings" not in said


@pytest.mark.slow
def test_warnings_of_steps_are_repeated_at_the_end(tmp_path):
    (tmp_path / "photos").mkdir()
    for number in range(8):
        print_ = np.random.default_rng(number).integers(0, 255, (24, 32, 3), dtype=np.uint8)
        write_image(tmp_path / f"photos/{number}.png", cv2.resize(print_, (320, 240), interpolation=cv2.INTER_CUBIC))
    table = tmp_path / "objects.tsv"
    table.write_text(f"dataset\tobject\timages\tmasks\theight_m\nphotos\tcup\t{tmp_path / 'photos'}\t\t\n")
    run = run_snakemake(tmp_path, "results/photos/cup/video/capture", "--config", f"objects_table={table}")
    assert run.returncode == 0, run.stdout
    end = run.stdout.split("Warnings (1):")[1]
    assert "results/photos/cup/video/logs/capture.log: blurred throughout" in end
