"""The tables of docs/results.md that come from committed CSVs: `python benchmarks/results_tables.py` writes them anew.

Each stands between `<!-- NAME -->` and `<!-- end -->`; a test says when they differ from the CSVs.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pandas as pd

from zeroshop_steps.report.reconstruction import PLACE
from zeroshop_steps.runtime.tables import read_table

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "results.md"
PUBLISHED_HEIGHTS = DOCS.parent / "src/zeroshop_steps/report/published_heights.csv"
DATASETS = {"demo": "demo", "ycbv": "YCB-V"}
METHODS = {"2dgs": "2DGS", "svraster": "SVRaster"}
MODELS = {"models": "true", "models_2dgs": "2dgs", "models_svraster": "svraster"}
FIGURES = {
    "f_score_1_percent": ("F-score at 1 %", ".3f"),
    "accuracy_mm": ("accuracy, mm", ".2f"),
    "completeness_mm": ("completeness, mm", ".2f"),
    "normal_error_deg": ("normal error, degrees", ".1f"),
    "psnr_db": ("PSNR, dB", ".1f"),
    "training_cpu_seconds": ("training, CPU s", ".0f"),
}


def read(name: str) -> pd.DataFrame:
    """A committed table, all of it as text."""
    return read_table(DOCS / f"{name}.csv")


def render(rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first row is its head."""
    head, *rest = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([head, "|---" * (head.count("|") - 1) + "|", *rest])


def render_grades() -> str:
    """How many objects have a good mesh, by scene."""
    cells = read("reconstruction").query("measure == 'grade'")
    rows = [["dataset", "method, cameras", "objects", "su_h", "su_l", "se"]]
    for (dataset, cameras, method), some in cells.groupby(["dataset", "registration", "nvs"]):
        good = some[some.value == "good"].groupby("scene").size()
        label = f"{METHODS[method]}, {'true' if cameras == 'truth' else 'COLMAP'}"
        rows.append([DATASETS[dataset], label, str(some.object.nunique()), *(str(good.get(scene, 0)) for scene in ("su_h", "su_l", "se"))])
    return render(rows)


def render_surfaces() -> str:
    """Mean and median figures over the captures and cameras with a mesh by both methods."""
    table = read("reconstruction").query("measure in @FIGURES")
    wide = table.assign(value=table.value.astype(float)).pivot(index=["dataset", *PLACE], columns="measure", values="value").reset_index()
    both = wide[wide.groupby(["dataset", "object", "scene", "registration"]).nvs.transform("nunique") == len(METHODS)]
    columns = [(dataset, method) for dataset in DATASETS for method in METHODS]
    parts = [both[(both.dataset == dataset) & (both.nvs == method)] for dataset, method in columns]
    rows = [["mean, median", *(f"{DATASETS[dataset]}: {METHODS[method]}" for dataset, method in columns)]]
    for measure, (text, digits) in FIGURES.items():
        rows.append([text, *(f"{part[measure].mean():{digits}}, {part[measure].median():{digits}}" for part in parts)])
    rows.append(["meshes", *(str(len(part)) for part in parts)])
    return render(rows)


def render_cameras() -> str:
    """What `auto` finds on plain ground and without ground."""
    rows = [["scene, dataset", "accepted", "by COLMAP, ALIKED, silhouettes", "mean error, mm: median, worst", "refused"]]
    for (scene, dataset), some in read("auto_cameras").groupby(["scene", "dataset"], sort=False):
        found = some[some.mean_mm != ""]
        by = [str((found.found_by == name).sum()) for name in ("colmap", "aliked", "silhouettes")] if (found.found_by != "").all() else []
        errors = found.mean_mm.astype(float)
        refused = some[some.mean_mm == ""].object.str.replace("obj_0000", "").str.replace("_", " ")
        figures = [f"{len(found)} of {len(some)}", ", ".join(by), f"{errors.median():.2f}, {errors.max():.2f}", ", ".join(refused)]
        rows.append([f"`{scene}`, {DATASETS[dataset]}", *figures])
    return render(rows)


def render_films() -> str:
    """Films of objects on plain tables."""
    rows = [["film", "camera error, mm", "IoU of masks: median, worst", "F-score", "grade"]]
    for row in read("plain_table_films").itertuples():
        grade = row.grade_by_photos + (f"; by truth {row.grade_by_truth}" if row.grade_by_truth != row.grade_by_photos else "")
        masks = f"{row.mask_iou_median}, {row.mask_iou_worst}"
        rows.append([f"{row.object}, {row.table}", row.camera_mean_mm, masks, row.f_score_1_percent, grade])
    return render(rows)


def render_heights() -> str:
    """Heights by the board beside published ones of the same kind of object."""
    ours = read("height").set_index(["dataset", "object"])
    published = read_table(PUBLISHED_HEIGHTS).query("ycbv_object != ''")
    rows = [["object", "true, mm", "error by the board", "thesis: height, error"]]
    for row in published.sort_values("ycbv_object").itertuples():
        found = ours.loc["ycbv", row.ycbv_object]
        label = f"{row.name.replace('_', ' ')} ({int(row.ycbv_object[-2:])})"
        error = f"{float(found.difference_percent):+.2f} %"
        theirs = f"{float(row.height_m) * 1000:.0f} mm, {float(row.difference_percent):+.2f} %"
        rows.append([label, f"{float(found.height_m) * 1000:.1f}", error, theirs])
    return render(rows)


def render_poses() -> str:
    """Average precision of detections and average recall of poses."""
    table = read("bop").query("object == '' and measure in ('ap', 'ar')")
    values = table.set_index(["dataset", "models", "task", "masks"]).value
    rows = [["models", "contour: AP", "render_compare, true masks: AR", "masks by contour: AR"]]
    for dataset, models in table[["dataset", "models"]].drop_duplicates().itertuples(index=False):
        keys = [("detection", ""), ("pose", "truth"), ("pose", "contour")]
        rows.append([f"{DATASETS[dataset]}, {MODELS[models]}", *(values[(dataset, models, *key)] for key in keys)])
    return render(rows)


def render_robustness() -> str:
    """Average recall of poses by true models that are scaled, or lack their underside."""
    table = read("robustness").query("object == '' and measure == 'ar'")
    values = table.set_index(["dataset", "amount"]).value.astype(float)
    amounts = ["-10 %", "-5 %", "-2 %", "0 %", "+2 %", "+5 %", "+10 %", "missing"]
    rows = [["models", *amounts[:-1], "no underside"]]
    rows += [[DATASETS[dataset], *(f"{values[dataset, amount]:.3f}" for amount in amounts)] for dataset in DATASETS]
    return render(rows)


def render_grasps() -> str:
    """Shares of the poses in which the object was grasped."""
    marks = read("grasp").query("measure == 'grasp' and object != '' and source == 'measured'")
    marks = marks.assign(models=marks.models.str.replace("delivered_", ""))
    rows = [["robot's meshes", "objects", "friction", "poses", "first attempt", "with a second one"]]
    for (models, friction), some in marks.groupby(["models", "friction"], sort=False):
        first, again = (some.value == "single").mean(), (some.value != "fail").mean()
        objects = len(some[["dataset", "object"]].drop_duplicates())
        rows.append([MODELS[models], str(objects), friction, str(len(some)), f"{first:.1%}", f"{again:.1%}"])
    thesis = read("grasp").query("source == 'thesis'")
    for models, some in thesis.groupby("models"):
        values = some.set_index("measure").value
        shares = [values[f"grasps {when} attempt, %"] + "%" for when in ("at the first", "with a second")]
        rows.append([f"thesis, a real robot: {MODELS[models]}", "8", "", "64", *shares])
    return render(rows)


def render_scenes() -> str:
    """What the robot makes of several things on a table."""
    table = read("grasp_scenes")
    table = table.assign(models=table.models.str.replace("delivered_", ""))
    values = table.set_index(["source", "models", "measure"]).value
    rows = [["robot's meshes", "objects", "segmented", "of these, right poses"]]
    for models in table[table.source == "measured"].models.unique():
        of = values["measured", models]
        names = ("objects segmented where they stand apart, %", "of those that stand apart, grasp poses that are right, %")
        rows.append([f"{MODELS[models]}, apart", of["objects, clear"], *(f"{of[name]} %" for name in names)])
        names = ("objects segmented where they overlap, %", "of these, grasp poses that are right, %")
        rows.append([f"{MODELS[models]}, overlapping", of["objects, overlapping"], *(f"{of[name]} %" for name in names)])
    for models in table[table.source == "thesis"].models.unique():
        of = values["thesis", models]
        rows.append([f"thesis, real scenes: {MODELS[models]}, overlapping", "48", *(f"{of[name]} %" for name in names)])
    return render(rows)


TABLES: dict[str, Callable[[], str]] = {
    "grades": render_grades,
    "surfaces": render_surfaces,
    "cameras": render_cameras,
    "heights": render_heights,
    "films": render_films,
    "poses": render_poses,
    "robustness": render_robustness,
    "grasps": render_grasps,
    "scenes": render_scenes,
}


def fill(text: str) -> str:
    """The page with every table made anew."""

    def replace(match: re.Match[str]) -> str:
        return f"<!-- {match[1]} -->\n{TABLES[match[1]]()}\n<!-- end -->"

    return re.sub(r"<!-- (\w+) -->\n.*?<!-- end -->", replace, text, flags=re.DOTALL)


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text()))
