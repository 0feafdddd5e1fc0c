"""The cells of the matrix: which of them tables name, and the files that tell of them."""

import functools
import itertools
import os

from snakemake.logging import logger

from zeroshop_steps.runtime import failures

CELL = "results/{dataset}/{object}/{scene}/{registration}/{nvs}"


AXES = {
    "registrations": methods.REGISTRATIONS,
    "nvs": methods.NVS,
    "detectors": methods.DETECTORS,
    "estimators": methods.ESTIMATORS,
}


def table_axis(axis):
    """The names that the config wants on an axis of the tables."""
    wanted = config["tables"][axis]
    return [name for name, method in AXES[axis].items() if not methods.lacks(method)] if wanted == "all" else wanted


@functools.cache
def say_what_is_left_out(*axes):
    """One line, once, on the methods that tables leave out because they cannot run here."""
    line = methods.left_out(*(AXES[axis] for axis in axes if config["tables"][axis] == "all"))
    if line:
        logger.info(line)


def cells_of(dataset, objects, scenes=None, registrations=None, nvs=None):
    """The coordinates of cells as dictionaries: these objects in every combination of the axes, by default those of the config."""
    virtual_dataset(dataset, "Tables compare with the truth, which photos lack.")
    if not (registrations and nvs):
        say_what_is_left_out("registrations", "nvs")
    axes = {
        "object": objects,
        "scene": scenes or (VIRTUAL_SCENES if config["tables"]["scenes"] == "all" else config["tables"]["scenes"]),
        "registration": registrations or table_axis("registrations"),
        "nvs": nvs or table_axis("nvs"),
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
    path = str(Path(CELL).parent / name)
    return lambda wildcards: list(dict.fromkeys(path.format(**cell) for cell in cells(wildcards)))


def parts_of_mesh(wildcards):
    """What the finished mesh is put together from. Whoever asks for an outcome wants failures recorded."""
    os.environ[failures.SWITCH] = "1"
    return [f"{CELL}/{part}".format(**wildcards) for part in ("unwrapped.ply", "texture.png", "frame.json")]


def measurements_of(wildcards):
    """The measurements of a cell, where there is a truth, and its grade; of one that failed, the record of its failure."""
    outcome = checkpoints.outcome.get(**wildcards).output.outcome
    if failures.read_failure(outcome):
        return [outcome]
    names = ("quality", "grade") if is_virtual(wildcards.dataset) else ("grade",)
    return [f"{CELL}/{name}.csv".format(**wildcards) for name in names]
