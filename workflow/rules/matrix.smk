"""The matrix: how every cell ended, and the slices of it that a user asks for.

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/cell.csv   one cell: its figures, or grade none and the reason
results/DATASET/OBJECT/cells.csv                         one object: every cell of it
results/DATASET/tables/SCENE/REGISTRATION/NVS.csv        one column: this cell of every object
results/DATASET/tables/quality.csv                       one table: every cell of every object

A failed cell is a result: in such a run a step that fails leaves a record, `outcome` ends in it, and the others go on.
"""

import functools
import itertools
import os

from snakemake.logging import logger

from zeroshop_steps import failures


# On a cluster, what takes a second is done where Snakemake runs.
localrules:
    outcome,
    cell,
    object_table,
    column_table,


CELL = "results/{dataset}/{object}/{scene}/{registration}/{nvs}"


def table_axis(axis, names):
    """The names that the config wants on an axis of the tables."""
    wanted = config["tables"][axis]
    return [name for name, method in names.items() if not methods.lacks(method, ROOT)] if wanted == "all" else wanted


@functools.cache
def say_what_is_left_out():
    """One line, once, on the methods that tables leave out because they cannot run here."""
    tables = [table for axis, table in (("registrations", methods.REGISTRATIONS), ("nvs", methods.NVS)) if config["tables"][axis] == "all"]
    line = methods.left_out(*tables, root=ROOT)
    if line:
        logger.info(line)


def cells_of(dataset, objects, scenes=None, registrations=None, nvs=None):
    """The coordinates of cells as dictionaries: these objects in every combination of the axes, by default those of the config."""
    virtual = [name for name in config["datasets"] if is_virtual(name)]
    known("virtual dataset", dataset, virtual, "Tables compare with the truth, which photos lack.")
    if not (registrations and nvs):
        say_what_is_left_out()
    axes = {
        "object": objects,
        "scene": scenes or (VIRTUAL_SCENES if config["tables"]["scenes"] == "all" else config["tables"]["scenes"]),
        "registration": registrations or table_axis("registrations", methods.REGISTRATIONS),
        "nvs": nvs or table_axis("nvs", methods.NVS),
    }
    return [{"dataset": dataset, **dict(zip(axes, values))} for values in itertools.product(*axes.values())]


def cells_of_object(wildcards):
    """One object: every cell of it that the config wants in tables."""
    check_object(wildcards)
    return cells_of(wildcards.dataset, [wildcards.object])


def cells_of_column(wildcards):
    """One column: the cell of these coordinates for every object."""
    return cells_of(wildcards.dataset, objects_of(wildcards.dataset), [wildcards.scene], [wildcards.registration], [wildcards.nvs])


def cells_of_table(wildcards):
    """One table: every cell that the config wants in it."""
    return cells_of(wildcards.dataset, objects_of(wildcards.dataset))


def figures_of(cells):
    """An input function: the figures of the cells that `cells` gives, each cell whether it failed or not."""
    return lambda wildcards: [f"{CELL}/cell.csv".format(**cell) for cell in cells(wildcards)]


def registrations_in(cells, name):
    """An input function: a file of each registration in the cells that `cells` gives, once."""
    path = CELL.rpartition("/")[0] + f"/{name}"
    return lambda wildcards: list(dict.fromkeys(path.format(**cell) for cell in cells(wildcards)))


def parts_of_mesh(wildcards):
    """What the finished mesh is put together from. Whoever asks for an outcome wants failures recorded."""
    os.environ[failures.SWITCH] = "1"
    return [f"{CELL}/{part}".format(**wildcards) for part in ("unwrapped.ply", "texture.png", "frame.json")]


def measurements_of(wildcards):
    """The measurements of a cell; of one that failed, the record of its failure."""
    outcome = checkpoints.outcome.get(**wildcards).output.outcome
    return outcome if failures.read_failure(outcome) else f"{CELL}/quality.csv".format(**wildcards)


checkpoint outcome:
    input:
        parts=parts_of_mesh,
    output:
        outcome="results/{dataset}/{object}/{scene}/{registration}/{nvs}/outcome.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/outcome.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/outcome.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    message:
        "Noting how {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}, ended"
    shell:
        "python -m zeroshop_steps.finish --method outcome --parts {input.parts} --out {output.outcome}"
        " --record-failure {output} > {log} 2>&1"


rule cell:
    input:
        measurements=measurements_of,
    output:
        table="results/{dataset}/{object}/{scene}/{registration}/{nvs}/cell.csv",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/cell.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/cell.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    message:
        "Gathering the figures of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.measurements} --out {output.table} > {log} 2>&1"


rule object_table:
    input:
        cells=figures_of(cells_of_object),
    output:
        table="results/{dataset}/{object}/cells.csv",
    log:
        "results/{dataset}/{object}/logs/cells.log",
    benchmark:
        "results/{dataset}/{object}/benchmarks/cells.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    message:
        "Gathering every cell of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.cells} --out {output.table} > {log} 2>&1"


rule column_table:
    input:
        cells=figures_of(cells_of_column),
    output:
        table="results/{dataset}/tables/{scene}/{registration}/{nvs}.csv",
    log:
        "results/{dataset}/tables/logs/{scene}.{registration}.{nvs}.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/{scene}.{registration}.{nvs}.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    message:
        "Gathering scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs} of every object of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.cells} --out {output.table} > {log} 2>&1"
