"""What several stages share: where results lie, the checked config, the known names, and errors that list them."""

import os
import re
import shlex
import sys
from pathlib import Path

from snakemake.exceptions import WorkflowError

from zeroshop_steps import methods
from zeroshop_steps.runtime.cache import check_cache
from zeroshop_steps.runtime.code_version import source_version
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.config_files import check_config, name_error, read_config_schema, read_objects

PROJECT = Path(workflow.snakefile).parents[2]
# Paths that the config names count from the clone; where the workflow came with the package, from the working directory.
ROOT = Path.cwd() if PROJECT.parts[-2:] == ("zeroshop_steps", "project") else PROJECT

# Where results lie: of an object, of its pictures in a scene, of their cameras by a registration, of a cell; and of a whole dataset.
RESULTS = config["results"]
OBJECT = f"{RESULTS}/{{dataset}}/{{object}}"
SCENE = f"{OBJECT}/{{scene}}"
RUN = f"{SCENE}/{{registration}}"
CELL = f"{RUN}/{{nvs}}"
BOP = f"{RESULTS}/{{dataset}}/bop"
TABLES = f"{RESULTS}/{{dataset}}/tables"

# Where a method cannot run here, its step records that as a failure, and the rest goes on.
RECORDS_REFUSALS = config["refusals"] == "record"
# Added to the commands of cells, which record other failures anyway; and to those that otherwise end with an error.
AND_REFUSALS = " --record-refusals" if RECORDS_REFUSALS else ""
RECORDED, RECORDED_FOLDER = (f" --record-failure {{output}}{slash}{AND_REFUSALS}" if RECORDS_REFUSALS else "" for slash in ("", "/"))

WITH_CAMERAS = f"(?!{methods.WITHOUT_CAMERAS}/)[^/]+"  # the registration of a cell that has cameras, as a regular expression

VIRTUAL_SCENES = ["su_l", "su_h", "se"]
# Photos as they are, and registered by what lies inside the masks alone.
WHOLE_SCENE, OBJECT_SCENE = PHOTO_SCENES = ["video", "video_segmented"]

# Steps run with the Python that runs Snakemake, activated or not; that of a conda environment finds them, too.
os.environ.update(
    PATH=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
    PYTHONPATH=os.pathsep.join([str(PROJECT / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]),
)
# Snakemake sets OMP_NUM_THREADS and its kin from the threads of a job; Numba and OpenCV read names of their own. NumPy's matrices are small:
# further threads of OpenBLAS only wait, and keep cores busy with it.
shell.prefix(
    'export NUMBA_NUM_THREADS="$OMP_NUM_THREADS" OPENCV_FOR_THREADS_NUM="$OMP_NUM_THREADS" OPENBLAS_NUM_THREADS=1 PYTHONHASHSEED=0; '
    # A step that was killed (137) or aborted by a library (134, 139) cannot say so itself.
    "trap 'case $? in 134|137|139) echo \"error: the step was killed or crashed, most often because memory or the disk ran out;"
    " give it more (--set-resources RULE:mem_mb=N) or run less beside it (--resources mem_mb=N)\" >&2;; esac' EXIT; "
)

try:
    check_cache()
    check_config(config, read_config_schema(PROJECT / "workflow/schemas/config.schema.yaml", methods.CHOICES, methods.SECTIONS))
    row_schema = PROJECT / "workflow/schemas/objects.schema.yaml"
    PHOTOS = read_objects(ROOT / config["objects_table"], row_schema, methods.HEIGHTS, methods.GIVEN_HEIGHTS)
except StepError as error:
    raise WorkflowError(str(error)) from None


wildcard_constraints:
    dataset="[^/]+",
    scene="[^/]+",
    registration="[^/]+",
    nvs="[^/.]+",


def per_attempt(amount):
    """Memory or time for a step: twice as much at the second attempt, and so on, if a profile submits failed jobs again."""
    return lambda wildcards, attempt: amount * attempt


def gpu_mem_of(section, needs):
    """GPU memory in MB that a step may take whose method `needs` finds by the wildcards; 0 where the config has it run on the processor."""
    return lambda wildcards: needs(wildcards).gpu_mem_mb(config[section].get(needs(wildcards).name) or {})


def gpu_of(section, needs):
    """How many GPUs such a step asks for: one or none."""
    return lambda wildcards: int(gpu_mem_of(section, needs)(wildcards) > 0)


def step_options(options):
    """Config keys as command line options: `max_features: 4000` becomes `--max-features 4000`. A list gives several words, null no option."""
    if options.get("weights"):  # the user's own lie where the config says, counted from the project's folder
        options = {**options, "weights": shlex.quote(os.path.relpath(ROOT / options["weights"]))}
    words = {key: value if isinstance(value, list) else [value] for key, value in options.items() if value is not None}
    return " ".join(" ".join([f"--{key.replace('_', '-')}", *map(str, values)]) for key, values in words.items())


# What a command runs: a stage and its method, and the method of the height within `shape`.
STEP = re.compile(r"zeroshop_steps\.(\w+) --method (\S+)|--(height) (\{params\.height\})")


def code_of(rule):
    """A parameter function: the fingerprint of the code that a rule's command runs, so that changed code makes its results stale."""
    steps = [(stage or height, method or height_method) for stage, method, height, height_method in STEP.findall(rule.shellcmd)]

    def fill(word, wildcards):
        found = re.fullmatch(r"\{(params|wildcards)\.(\w+)\}", word)
        value = getattr({"params": rule.params, "wildcards": wildcards}[found[1]], found[2]) if found else word
        return value(wildcards) if callable(value) else value

    return lambda wildcards: source_version(tuple(f"{stage}.{fill(method, wildcards)}" for stage, method in steps))


def inputs_as_options(wildcards, input):
    """The inputs of a rule as command line options of the same names; one that is empty is left out."""
    return step_options({name: paths or None for name, paths in input.items()})


def require_known(what, name, names, remedy):
    """`name`, or an error that lists the known names."""
    if name not in names:
        raise WorkflowError(name_error(what, name, names, remedy))
    return name


def usable(what, name, table, remedy):
    """`name`, or an error where it is no method or lacks something here; `table` is one of zeroshop_steps.methods.

    Where refusals are recorded, its step says what is lacking.
    """
    if RECORDS_REFUSALS:
        return require_known(what, name, table, remedy)
    if reason := methods.refusal(what, require_known(what, name, table, remedy), table):
        raise WorkflowError(reason)
    return name


def datasets_of(*kinds):
    """A regular expression of the datasets of these kinds, for a rule's wildcard constraint; matches nothing if there is none."""
    return "|".join(name for name, dataset in config["datasets"].items() if dataset["kind"] in kinds) or "(?!)"


def dataset_named(name):
    """A dataset of the config, or an error that lists those that exist."""
    known = config["datasets"]
    return known[require_known("dataset", name, known, "Datasets are listed in config/config.yaml under datasets.")]


def is_virtual(dataset):
    """Whether a dataset has models, so that captures are rendered and the truth is known."""
    return dataset_named(dataset)["kind"] not in ("photos", "films")


def is_filmed(dataset):
    """Whether a dataset's captures are rendered films: they are processed like a user's own videos, and the truth is known."""
    return dataset_named(dataset)["kind"] == "films"


def film_passes(dataset):
    """How often each object of a dataset of rendered films is filmed: 2 if it is turned over and filmed again."""
    return dataset_named(dataset).get("passes", 1)


def knows_truth(dataset):
    """Whether meshes of a dataset can be measured against a true model: those of rendered images and films."""
    return is_virtual(dataset) or is_filmed(dataset)


def virtual_dataset(name, remedy=""):
    """`name`, or an error that lists the datasets that have models."""
    return require_known("virtual dataset", name, [dataset for dataset in config["datasets"] if is_virtual(dataset)], remedy)


def objects_of(dataset):
    """The objects of a dataset: from the config, or for photos from the table."""
    described = dataset_named(dataset)
    if described["kind"] == "photos":
        return [name for owner, name in PHOTOS if owner == dataset]
    return [name for names in described["of"].values() for name in names] if described["kind"] == "films" else described["objects"]
