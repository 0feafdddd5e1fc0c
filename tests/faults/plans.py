"""Faults of the config, the table of objects and their paths: all are found before anything starts."""

import os
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

from faults.photos import take_photos
from helpers.faults import Fault
from helpers.paths import REPOSITORY
from helpers.planner import call_snakemake
from helpers.running import run_snakemake

HEADER = "dataset\tobject\timages\tmasks\theight_m\theight_method"
TARGET = "results/photos/thing/2dgs.ply"


def plan(folder: Path, *words: str) -> int:
    """Ask Snakemake what would run; what it says goes to stderr."""
    run = run_snakemake(folder, *words, "-n")
    print(run.stdout, file=sys.stderr)
    return run.returncode


def plan_config(text: str | bytes) -> Callable[[Path], int]:
    """Plan a demo object with a file of changes."""

    def run(folder: Path) -> int:
        (folder / "changes.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
        return plan(folder, "results/demo/mug/2dgs.ply", "--configfile", "changes.yaml")

    return run


def plan_row(row: str, images: str = "photos") -> Callable[[Path], int]:
    """Plan the user's own photos, with a row of the table."""

    def run(folder: Path) -> int:
        take_photos(folder).rename(folder / "given")
        place = folder / images
        place.parent.mkdir(exist_ok=True)
        (folder / "given").rename(place)
        (folder / "objects.tsv").write_text(f"{HEADER}\n{row.replace('IMAGES', str(place))}\n")
        return plan(folder, TARGET, "--config", f"objects_table={folder / 'objects.tsv'}")

    return run


def plan_table(make: Callable[[Path], object]) -> Callable[[Path], int]:
    """Plan with a table that is no table."""

    def run(folder: Path) -> int:
        make(folder / "objects.tsv")
        return plan(folder, TARGET, "--config", f"objects_table={folder / 'objects.tsv'}")

    return run


def plan_defaults_in_latin_1(folder: Path) -> int:
    """Plan in a copy of the project whose own config was saved in another encoding."""
    for part in ("workflow", "config"):
        shutil.copytree(REPOSITORY / part, folder / "project" / part)
    with (folder / "project/config/config.yaml").open("ab") as file:
        file.write(b"# Gr\xfc\xdfe\n")
    words = ["--snakefile", str(folder / "project/workflow/Snakefile"), "-n", "results/demo/mug/2dgs.ply"]
    run = call_snakemake(folder, words, dict(os.environ))
    print(run.stdout, file=sys.stderr)
    return run.returncode


def link_to_itself(table: Path) -> None:
    """A link that leads to itself."""
    os.symlink(table, table)


def plan_photos_of_tomorrow(folder: Path) -> int:
    """Plan with photos from a camera whose clock is ahead."""
    photos = take_photos(folder)
    os.utime(photos / "3.jpg", times=(time.time() + 86_400,) * 2)
    (folder / "objects.tsv").write_text(f"{HEADER}\nphotos\tthing\t{photos}\t\t0.1\t\n")
    return plan(folder, TARGET, "--config", f"objects_table={folder / 'objects.tsv'}")


FAULTS = [
    Fault(
        "photos of tomorrow",
        plan_photos_of_tomorrow,
        (r"1 of the user's files are from the future, such as .*photos/3\.jpg", r"touch photos/\*"),
    ),
    Fault("NaN in a range", plan_config("finish: {grade: {displaced_share: [.nan, 0.4]}}"), (r"displaced_share\.0: nan is not a finite",)),
    Fault("infinity in a range", plan_config("capture: {samples: .inf}"), (r"capture\.samples",)),
    Fault(
        "swapped limits of a grade",
        plan_config("finish: {grade: {displaced_share: [0.4, 0.035]}}"),
        (r"finish\.grade\.displaced_share is \[0\.4, 0\.035\]", "must be the stricter one"),
    ),
    Fault(
        "a demo object named report",
        plan_config("datasets: {demo: {objects: [report]}}"),
        (r"datasets\.demo\.objects: report is a folder",),
    ),
    Fault("a film of an object named bop", plan_config("datasets: {films: {of: {demo: [bop]}}}"), (r"datasets\.films\.of\.demo: bop is",)),
    Fault("a dataset without a kind", plan_config("datasets: {mine: {models_folder: x}}"), (r"datasets\.mine: 'kind' is a required",)),
    Fault("a short checksum", plan_config("datasets: {ycbv: {models_sha256: abc}}"), (r"datasets\.ycbv.*models_sha256",)),
    *(
        Fault(f"an object named {name}", plan_row(f"photos\t{name}\tIMAGES\t\t0.1\t"), (f"line 2: {name} is a folder", "another name"))
        for name in ("bop", "tables", "report")
    ),
    Fault("known without a height", plan_row("photos\tthing\tIMAGES\t\t\tknown"), ("line 2: height_method known needs", "height_m")),
    Fault("a folder with braces", plan_row("photos\tthing\tIMAGES\t\t0.1\t", "a{b}c"), ("photos thing: the path of its images", "rename")),
    Fault("a config in Latin-1", plan_defaults_in_latin_1, (r"config/config\.yaml is not UTF-8 text: see line \d+", "encoding UTF-8")),
    Fault("a table that is a folder", plan_table(Path.mkdir), (r"objects\.tsv cannot be read: Is a directory", "objects_table")),
    Fault("a table in Latin-1", plan_table(lambda table: table.write_bytes(b"dataset\tGr\xfc\xdfe\n")), (r"objects\.tsv is not UTF-8",)),
    Fault("a table that links to itself", plan_table(link_to_itself), (r"objects\.tsv cannot be read: Too many levels", "remove it")),
]
