"""What several stages share: where results lie, the checked config, what the package knows of the plan, and what all rules ask for."""

import functools
import os
import re
import shlex
import sys
from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.logging import logger

from zeroshop_steps import methods
from zeroshop_steps.plan.pages import Pages
from zeroshop_steps.plan.captures import BOARD_SCENE, JOINED_PHOTOS, JOINED_SCENE, LATER_PASSES, OBJECT_SCENE, TURNED_SCENE, WHOLE_SCENE
from zeroshop_steps.plan.datasets import NOTHING
from zeroshop_steps.plan.step_options import check_step_options
from zeroshop_steps.runtime.cache import check_cache
from zeroshop_steps.runtime.code_version import source_version
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.config_files import check_config, read_config_schema, read_objects

PROJECT = Path(workflow.snakefile).parents[2]
# Paths that the config names count from the clone; where the workflow came with the package, from the working directory.
ROOT = Path.cwd() if PROJECT.parts[-2:] == ("zeroshop_steps", "project") else PROJECT

# Steps run with the Python that runs Snakemake, activated or not; that of a conda environment finds them, too.
os.environ.update(
    PATH=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
    PYTHONPATH=os.pathsep.join([str(PROJECT / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]),
)
# Snakemake sets OMP_NUM_THREADS and its kin from the threads of a job; Numba and OpenCV read names of their own. NumPy's matrices are
# small: further threads of OpenBLAS only wait, and keep cores busy with it.
shell.prefix(
    'export NUMBA_NUM_THREADS="$OMP_NUM_THREADS" OPENCV_FOR_THREADS_NUM="$OMP_NUM_THREADS" OPENBLAS_NUM_THREADS=1 PYTHONHASHSEED=0; '
    # A step that was killed (137) or aborted by a library (134, 139) cannot say so itself.
    "trap 'case $? in 134|137|139) echo \"error: the step was killed or crashed, most often because memory or the disk ran out;"
    " give it more (--set-resources RULE:mem_mb=N) or run less beside it (--resources mem_mb=N)\" >&2;; esac' EXIT; "
)

try:
    check_cache()
    config_schema = read_config_schema(PROJECT / "workflow/schemas/config.schema.yaml", methods.CHOICES, methods.SECTIONS)
    check_config(config, config_schema)
    row_schema = PROJECT / "workflow/schemas/objects.schema.yaml"
    rows = read_objects(ROOT / config["objects_table"], row_schema, methods.HEIGHTS, methods.GIVEN_HEIGHTS)
    # What rules ask when Snakemake plans: its methods are the input functions.
    plan = Pages(config, ROOT, rows, logger.info)
    if workflow.is_main_process:
        check_step_options(plan.given, config_schema)
except StepError as error:
    raise WorkflowError(str(error)) from None

# Where results lie: of an object, of its pictures in a scene, of their cameras by a registration, of a cell; and of a whole dataset.
OBJECT, SCENE, RUN, CELL, BOP, TABLES, REPORT = (
    plan.object,
    plan.scene,
    plan.run,
    plan.cell,
    plan.bop,
    plan.tables,
    plan.report,
)
step_options = plan.options
settings = plan.config  # with every section complete

# Where a method cannot run here, its step records that as a failure, and the rest goes on. Added to the commands of cells, which record
# other failures anyway; and to those that otherwise end with an error.
AND_REFUSALS = " --record-refusals" if plan.records_refusals else ""
RECORDED, RECORDED_FOLDER = (f" --record-failure {{output}}{slash}{AND_REFUSALS}" if plan.records_refusals else "" for slash in ("", "/"))

# Datasets of models, and those that are processed like the user's own pictures.
OF_MODELS, OF_PHOTOS = plan.of_kinds("demo", "bop"), plan.of_kinds("photos", "films")
WITH_CAMERAS = f"(?!{methods.WITHOUT_CAMERAS}/)[^/]+"  # the registration of a cell that has cameras, as a regular expression


wildcard_constraints:
    dataset="(?!imported/)[^/]+",  # `zeroshop` puts captures of other programs there, with a cameras.json
    object=rf"(?!(?:bop|tables|report)/)(?!{plan.named or NOTHING})[^/]+",  # these folders hold what belongs to a whole dataset
    scene="[^/]+",
    registration="[^/]+",
    nvs="[^/.]+",


def needs(mem_mb, runtime, gpu_mem_mb=None):
    """The resources of a rule: MB and minutes, each twice as much at the second attempt, and so on, if a profile submits failed jobs again.

    A step that may run on a GPU asks for one where it takes any of its memory. All three are numbers or functions of the wildcards.
    """
    mb, minutes, on_card = (
        amount if callable(amount) else lambda wildcards, amount=amount: amount for amount in (mem_mb, runtime, gpu_mem_mb)
    )
    gpu = {"gpu": lambda wildcards: int(on_card(wildcards) > 0), "gpu_mem_mb": lambda wildcards: on_card(wildcards)}
    return {
        "mem_mb": lambda wildcards, attempt: attempt * mb(wildcards),
        "runtime": lambda wildcards, attempt: attempt * minutes(wildcards),
        **({} if gpu_mem_mb is None else gpu),
    }


def needs_of(section, method_of, mem_mb=0, runtime=None):
    """The same for a step whose method `method_of` finds by the wildcards: at least this memory; its own minutes, or those given."""
    return needs(
        lambda wildcards: max(mem_mb, method_of(wildcards).mem_mb),
        runtime or (lambda wildcards: method_of(wildcards).runtime_min),
        lambda wildcards: plan.gpu_mem_mb(section, method_of(wildcards)),
    )


def given(*names):
    """A parameter function: these inputs of a rule, or all with names, as options of the same names; one that is empty is left out."""
    return lambda wildcards, input: step_options({name: input.get(name) or None for name in names or input.keys()})


# What a command runs: a stage and its method, and the method of the height within `shape`.
STEP = re.compile(r"zeroshop_steps\.(\w+) --method (\S+)|--(height) (\{params\.height\})")


# Of a plan with thousands of jobs, half of the time was this. The code of a plan is that of its start.
version_of = functools.cache(source_version)


def code_of(rule):
    """A parameter function: the fingerprint of the code that a rule's command runs, so that changed code makes its results stale."""
    steps = [(stage or height, method or height_method) for stage, method, height, height_method in STEP.findall(rule.shellcmd)]

    def fill(word, wildcards):
        found = re.fullmatch(r"\{(params|wildcards)\.(\w+)\}", word)
        value = getattr({"params": rule.params, "wildcards": wildcards}[found[1]], found[2]) if found else word
        return value(wildcards) if callable(value) else value.format(**wildcards)

    return lambda wildcards: version_of(tuple(f"{stage}.{fill(method, wildcards)}" for stage, method in steps))
