"""Report: what a dataset's results look like, in any browser.

results/DATASET/report/index.html        the gallery and the tables
results/DATASET/report/objects/OBJECT    the page of an object
"""

from zeroshop_steps.runtime.config_files import config_changes

REPORT = f"{RESULTS}/{{dataset}}/report"


def cells_of_page(
    wildcards,
):
    """The cells of an object that are made for its page: the chosen ones, all, or none (the page then shows what exists)."""
    check_object(wildcards)
    if config["report"]["cells"] == "present":
        return []
    if not is_virtual(wildcards.dataset):
        cell = {"dataset": wildcards.dataset, "object": wildcards.object, **chosen_run(wildcards)}
        return [{**cell, "nvs": nvs} for nvs in surfaces_with_cameras("the report")]
    if config["report"]["cells"] == "all":
        return cells_of_object(wildcards)
    chosen = config["chosen"]["virtual"]
    return cells_of(wildcards.dataset, [wildcards.object], [chosen["scene"]], [chosen["registration"]])


def parts_of_page(
    wildcards,
):
    """How each of these cells ended: its measurements, or of the user's own photos its mesh and grade; or the record of its failure."""
    cells = cells_of_page(wildcards)
    if is_virtual(wildcards.dataset):
        return [f"{CELL}/cell.csv".format(**cell) for cell in cells]
    return [part for cell in cells for part in (f"{CELL}/{name}".format(**cell) for name in ("mesh.ply", "grade.json"))]


def other_cells(
    wildcards,
):
    """Files of other cells, with their times: a parameter, so that the page is made again when these change."""
    folder = Path(OBJECT.format(**wildcards))
    asked = {CELL.format(**cell) for cell in cells_of_page(wildcards)}
    made = [*folder.glob("*/*/*/outcome.json"), *folder.glob("*/*/*/mesh.ply"), *folder.glob("*/*/*/grade.json")]
    return [f"{path} {path.stat().st_mtime_ns}" for path in sorted(made) if str(path.parent) not in asked]


def first_shown(
    wildcards,
):
    """The scene and registration that the page shows first."""
    chosen = chosen_run(wildcards)
    return f"{chosen['scene']}/{chosen['registration']}"


def changes_option(
    wildcards,
):
    """The option that tells the page with which changes of the config its cells were made."""
    changes = config_changes(config, PROJECT / "config/config.yaml", ignored=("targets", "tables", "report", "chosen"))
    return f"--config {' '.join(map(shlex.quote, changes))}" if changes else ""


def pages_of_report(
    wildcards,
):
    """The page of every object of the dataset."""
    return [f"{RESULTS}/{wildcards.dataset}/report/objects/{name}" for name in objects_of(wildcards.dataset)]


def tables_there(
    wildcards,
):
    """The dataset's tables on disk with their times: the report shows those that are there."""
    folder = Path(TABLES.format(**wildcards))
    return [f"{path} {path.stat().st_mtime_ns}" for path in sorted(folder.glob("*.csv"))]


localrules:
    report_index,


rule report_object:
    input:
        cells=parts_of_page,
    output:
        page=directory(f"{REPORT}/objects/{{object}}"),
    log:
        f"{REPORT}/logs/{{object}}.log",
    benchmark:
        f"{REPORT}/benchmarks/{{object}}.tsv"
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        folder=lambda wildcards: OBJECT.format(**wildcards),
        chosen=first_shown,
        options=step_options(config["report"]["page"]),
        changes=changes_option,
        others=other_cells,
    message:
        "Writing the report's page of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.report --method object_page --object {params.folder} --chosen {params.chosen}"
        " {params.options} {params.changes} --out {output.page} > {log} 2>&1"


rule report_index:
    input:
        pages=pages_of_report,
    output:
        index=f"{REPORT}/index.html",
        tables=f"{REPORT}/tables.html",
        assets=directory(f"{REPORT}/assets"),
        downloads=directory(f"{REPORT}/downloads"),
    log:
        f"{REPORT}/logs/report_index.log",
    benchmark:
        f"{REPORT}/benchmarks/report_index.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        tables=TABLES,
        measured=tables_there,
    message:
        "Writing the report of {wildcards.dataset}: open {output.index} in a browser"
    shell:
        "python -m zeroshop_steps.report --method gallery --dataset {wildcards.dataset} --pages {input.pages}"
        " --tables {params.tables} --out {output.index} > {log} 2>&1"
