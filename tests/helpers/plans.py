"""What tests of plans share."""

from collections.abc import Mapping
from pathlib import Path

from helpers.paths import REPOSITORY
from zeroshop_steps import methods

FINISH = ["shape", "texture", "publish"]
SURFACE = ["stereo", "train_2dgs", "fuse_2dgs"]
CELL = [*SURFACE, *FINISH, "evaluate"]
PHOTO_CELL = [*SURFACE, *FINISH, "evaluate_photos"]


def photo_table(folder: Path, images: Path | str, masks: Path | str, height: str = "") -> tuple[str, str]:
    """A table with one capture; returns the options that make the workflow read it."""
    table = folder / "objects.tsv"
    table.write_text(f"dataset\tobject\timages\tmasks\theight_m\nphotos\tcup\t{images}\t{masks}\t{height}\n")
    return "--config", f"objects_table={table}"


def able(table: Mapping[str, methods.Method]) -> int:
    """How many methods of a table "all" means in a folder without weights, such as those of these tests."""
    return sum(not (methods.lacks(method, REPOSITORY / "tests") or method.tries or method.given_cameras) for method in table.values())
