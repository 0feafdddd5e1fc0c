"""What the report shows: the cells that it waits for, and those that lie on disk besides."""


def cells_of_page(wildcards):
    """The cells of an object that its page waits for, as the config says: chosen, all or none (only what is present is shown)."""
    check_object(wildcards)
    if config["report"]["cells"] == "present":
        return []
    if not is_virtual(wildcards.dataset):
        cell = {"dataset": wildcards.dataset, "object": wildcards.object, **config["chosen"]["photos"]}
        return [{**cell, "nvs": nvs} for nvs in table_axis("nvs")]
    if config["report"]["cells"] == "all":
        return cells_of_object(wildcards)
    chosen = config["chosen"]["virtual"]
    return cells_of(wildcards.dataset, [wildcards.object], [chosen["scene"]], [chosen["registration"]])


def parts_of_page(wildcards):
    """How each of these cells ended: its measurements, or the record of its failure."""
    cells = cells_of_page(wildcards)
    if is_virtual(wildcards.dataset):
        return [f"{CELL}/cell.csv".format(**cell) for cell in cells]
    return [part for cell in cells for part in parts_of_photographed(cell)]


def parts_of_photographed(cell):
    """The finished mesh of a cell of the user's own photos and its grade; of one that failed, the record of its failure."""
    outcome = checkpoints.outcome.get(**cell).output.outcome
    return [outcome] if failures.read_failure(outcome) else [f"{CELL}/{name}".format(**cell) for name in ("mesh.ply", "grade.json")]


def other_cells(wildcards):
    """What lies on disk of cells that the page does not wait for, with its time: the page is made again when that changes."""
    folder = Path(shown_object(wildcards))
    asked = {CELL.format(**cell) for cell in cells_of_page(wildcards)}
    made = [*folder.glob("*/*/*/outcome.json"), *folder.glob("*/*/*/mesh.ply"), *folder.glob("*/*/*/grade.json")]
    return [f"{path} {path.stat().st_mtime_ns}" for path in sorted(made) if str(path.parent) not in asked]


def shown_object(wildcards):
    """The folder of the object, there or not."""
    return f"results/{wildcards.dataset}/{wildcards.object}"


def chosen_run(wildcards):
    """The scene and registration that the page shows first."""
    chosen = config["chosen"]["virtual" if is_virtual(wildcards.dataset) else "photos"]
    return f"{chosen['scene']}/{chosen['registration']}"


def changes_option():
    """The option that tells the page with which changes of the config its cells were made."""
    changes = config_changes(config, ROOT / "config/config.yaml", ignored=("targets", "tables", "report", "chosen"))
    return f"--config {' '.join(map(shlex.quote, changes))}" if changes else ""


def pages_of_report(wildcards):
    """The page of every object of the dataset."""
    return [f"results/{wildcards.dataset}/report/objects/{name}" for name in objects_of(wildcards.dataset)]


def tables_there(wildcards):
    """The dataset's tables on disk with their times: the report shows those that are there."""
    folder = Path(f"results/{wildcards.dataset}/tables")
    return [f"{path} {path.stat().st_mtime_ns}" for path in sorted(folder.glob("*.csv"))]


def published_option(wildcards):
    """The option that puts published figures beside ours, for the dataset that has some."""
    return "--published" if wildcards.dataset == "ycbv" else ""
