"""The matrix: how every cell ended, and the slices of it that a user asks for.

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/cell.csv   one cell: its grade and figures, or grade none and the reason
results/DATASET/OBJECT/cells.csv                         one object: every cell of it
results/DATASET/tables/SCENE/REGISTRATION/NVS.csv        one column: this cell of every object
results/DATASET/tables/reconstruction.csv                one table: every cell of every object (tables.smk)

A failed cell is a result: a step of a cell that fails leaves a record (`--record-failure`), the steps after it pass it on, and the other
cells go on. The chosen mesh is never a record: asked for, such a cell ends with the reason.
"""

import functools
import itertools

from snakemake.logging import logger

SURFACES_WITHOUT_CAMERAS = [name for name, method in methods.SURFACES.items() if not method.registration]
# Steps that tell a cell's coordinates from its path are told where these begin; in the usual folder they know.
BELOW_RESULTS = "" if RESULTS == "results" else f" --root {RESULTS}"
# Those that find objects and poses, with the networks that the config names.
DETECTORS = {name: with_own_weights("detect", name, method) for name, method in methods.DETECTORS.items()}
# Each of them with each of the networks that can propose regions to it, whatever the config says: DETECTOR_NETWORK, such as cnos_sam.
PROPOSING = {
    f"{name}_{network}": (name, network) for name, method in methods.DETECTORS.items() for network in method.choices.get("proposals", {})
}
ESTIMATORS = {name: with_own_weights("pose", name, method) for name, method in methods.ESTIMATORS.items()}
AXES = {
    "registrations": methods.REGISTRATIONS,
    "nvs": methods.SURFACES,
    "detectors": DETECTORS,
    "estimators": ESTIMATORS,
}


def detector_options(
    name,
):
    """The options of a detector, or of one in PROPOSING, that the config gives."""
    detector, network = PROPOSING.get(name, (name, None))
    return (config["detect"].get(detector) or {}) | ({"proposals": network} if network else {})


ALL_DETECTORS = DETECTORS | {name: methods.DETECTORS[own].with_options(detector_options(name)) for name, (own, _) in PROPOSING.items()}


def table_axis(
    axis,
):
    """The names that the config wants on an axis of the tables."""
    wanted = config["tables"][axis]
    if wanted != "all":
        return wanted
    return [name for name, method in AXES[axis].items() if not (methods.lacks(method) or method.tries or method.given_cameras)]


def surfaces_with_cameras(
    what,
):
    """Those of the surface methods in tables whose meshes are finished and measured; `what` asks for them, and needs one."""
    names = [name for name in table_axis("nvs") if methods.SURFACES[name].registration]
    if not names:
        raise WorkflowError(f"tables.nvs: {what} needs a surface method that uses cameras; add one")
    return names


def measured_surfaces(
    what,
):
    """Those of them that measure: a generated mesh is a guess."""
    return [name for name in surfaces_with_cameras(what) if not methods.SURFACES[name].generated]


@functools.cache
def say_what_is_left_out(
    *axes,
):
    """One line, once, on the methods that tables leave out because they cannot run here."""
    line = methods.left_out(*(AXES[axis] for axis in axes if config["tables"][axis] == "all"))
    if line:
        logger.info(line)


def cells_of(
    dataset,
    objects,
    scenes=None,
    registrations=None,
    nvs=None,
):
    """The coordinates of cells as dictionaries: these objects in every combination of the axes, by default those of the config.

    A surface method that needs no cameras has cells of one registration, WITHOUT_CAMERAS, and the others have none of it. Rendered films
    are registered as photos are.
    """
    if is_filmed(dataset):
        whole = JOINED_PHOTOS if film_passes(dataset) > 1 else WHOLE_SCENE
        scenes, registrations = scenes or [whole], registrations or [config["chosen"]["photos"]["registration"]]
    else:
        virtual_dataset(dataset, "Tables compare with the truth, which photos lack.")
    if not (registrations and nvs):
        say_what_is_left_out("registrations", "nvs")
    axes = {
        "object": objects,
        "scene": scenes or (VIRTUAL_SCENES if config["tables"]["scenes"] == "all" else config["tables"]["scenes"]),
        "registration": registrations or [*table_axis("registrations"), methods.WITHOUT_CAMERAS],
        "nvs": nvs or table_axis("nvs"),
    }
    cells = [{"dataset": dataset, **dict(zip(axes, values))} for values in itertools.product(*axes.values())]
    cells = [cell for cell in cells if (cell["registration"] == methods.WITHOUT_CAMERAS) == (cell["nvs"] in SURFACES_WITHOUT_CAMERAS)]
    if not cells:
        raise WorkflowError(
            f"there is no such cell: {', '.join(SURFACES_WITHOUT_CAMERAS) or 'no surface method'} goes with registration"
            f" {methods.WITHOUT_CAMERAS}, every other surface method with a registration"
        )
    return cells


def cells_of_object(
    wildcards,
):
    """One object: every cell of it that the config wants in tables."""
    check_object(wildcards)
    return cells_of(wildcards.dataset, [wildcards.object])


def cells_of_column(
    wildcards,
):
    """One column: the cell of these coordinates for every object."""
    return cells_of(wildcards.dataset, objects_of(wildcards.dataset), [wildcards.scene], [wildcards.registration], [wildcards.nvs])


def rows_of_table(
    wildcards,
):
    """One table: every cell that the config wants in it."""
    return cells_of(wildcards.dataset, objects_of(wildcards.dataset))


def cells_of_table(
    wildcards,
):
    """Those of these cells that have cameras: each has a finished mesh and a grade, unless it failed."""
    return [cell for cell in rows_of_table(wildcards) if cell["registration"] != methods.WITHOUT_CAMERAS]


def figures_of(
    cells,
):
    """An input function: the figures of the cells that `cells` gives, each cell whether it failed or not."""
    return lambda wildcards: [f"{CELL}/cell.csv".format(**cell) for cell in cells(wildcards)]


def measurements_of(
    wildcards,
):
    """The measurements of a cell, where there is a truth, and its grade, or records of its failure; without cameras, there is nothing else."""
    if wildcards.registration == methods.WITHOUT_CAMERAS:
        return f"{CELL}/outcome.json".format(**wildcards)
    names = ["quality.csv", "grade.csv"] if knows_truth(wildcards.dataset) else ["grade.csv"]
    return [f"{CELL}/{name}".format(**wildcards) for name in names]


# On a cluster, what takes a second is done where Snakemake runs.
localrules:
    outcome_without_cameras,
    cell,
    object_table,
    column_table,


rule outcome_without_cameras:
    input:
        mesh=raw_mesh_of,
    output:
        outcome=f"{CELL}/outcome.json",
    log:
        f"{CELL}/logs/outcome.log",
    benchmark:
        f"{CELL}/benchmarks/outcome.tsv"
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Noting that {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, ended with its raw mesh"
    shell:
        "python -m zeroshop_steps.evaluate --method outcome --mesh {input.mesh} --out {output.outcome}"
        " --record-failure {output} > {log} 2>&1"


rule cell:
    input:
        measurements=measurements_of,
    output:
        table=f"{CELL}/cell.csv",
    log:
        f"{CELL}/logs/cell.log",
    benchmark:
        f"{CELL}/benchmarks/cell.tsv"
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Gathering the figures of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input}" f"{BELOW_RESULTS}" " --out {output.table} > {log} 2>&1"


use rule cell as object_table with:
    input:
        cells=figures_of(cells_of_object),
    output:
        table=f"{OBJECT}/cells.csv",
    log:
        f"{OBJECT}/logs/cells.log",
    benchmark:
        f"{OBJECT}/benchmarks/cells.tsv"
    message:
        "Gathering every cell of {wildcards.dataset} {wildcards.object}"


use rule cell as column_table with:
    input:
        cells=figures_of(cells_of_column),
    output:
        table=f"{TABLES}/{{scene}}/{{registration}}/{{nvs}}.csv",
    log:
        f"{TABLES}/logs/{{scene}}.{{registration}}.{{nvs}}.log",
    benchmark:
        f"{TABLES}/benchmarks/{{scene}}.{{registration}}.{{nvs}}.tsv"
    message:
        "Gathering scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs} of every object of {wildcards.dataset}"
