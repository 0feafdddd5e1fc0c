"""What the rules share: the checked config, the known names, and errors that list them."""

import os
import shlex
import sys
from dataclasses import replace
from pathlib import Path

from snakemake.exceptions import WorkflowError

from zeroshop_steps import methods
from zeroshop_steps.runtime.cache import check_cache
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.settings import check_config, config_changes, name_error, read_objects

ROOT = Path(workflow.basedir).parent
VIRTUAL_SCENES = ["su_l", "su_h", "se"]
# With a printed board beside the object: for measuring how well a height is found (height.smk), in no table of meshes.
BOARD_SCENE = "su_b"
# Photos as they are, and registered by what lies inside the masks alone.
WHOLE_SCENE, OBJECT_SCENE = PHOTO_SCENES = ["video", "video_segmented"]
# The record of the training of each surface method, in its cell.
TRAINING_RECORDS = {"2dgs": "splats/training", "svraster": "voxels/training"}

# What BlenderProc's environment consists of, where it says that it is ready, and the minutes that renderers may take for one capture.
BLENDER_REQUIREMENTS = os.path.relpath(ROOT / "workflow/envs/blenderproc.txt")
BLENDER_RECORD = "resources/envs/blenderproc.json"
RENDER_MINUTES = {"raycast": 10, "blenderproc": 240}

# The steps run with the Python that runs Snakemake, whether or not its environment is activated; that of a conda environment
# finds them, too.
os.environ.update(
    PATH=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
    PYTHONPATH=os.pathsep.join([str(ROOT / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]),
)
# Snakemake sets OMP_NUM_THREADS and its kin from the threads of a job; Numba and OpenCV read names of their own.
shell.prefix(
    'export NUMBA_NUM_THREADS="$OMP_NUM_THREADS" OPENCV_FOR_THREADS_NUM="$OMP_NUM_THREADS" PYTHONHASHSEED=0; '
    # A killed step cannot say so itself.
    "trap '[ $? -ne 137 ] || echo \"error: the step was killed, most often because memory ran out;"
    " give it more (--set-resources RULE:mem_mb=N) or run less beside it (--resources mem_mb=N)\" >&2' EXIT; "
)

try:
    check_cache()
    check_config(config, ROOT / "workflow/schemas/config.schema.yaml")
    PHOTOS = read_objects(ROOT / config["objects_table"], ROOT / "workflow/schemas/objects.schema.yaml")
except StepError as error:
    raise WorkflowError(str(error)) from None


wildcard_constraints:
    dataset="[^/]+",
    # These folders hold what belongs to a whole dataset.
    object=r"(?!(?:bop|tables)/)[^/]+",
    scene="[^/]+",
    registration="[^/]+",
    nvs="[^/.]+",


def datasets_of(*kinds):
    """A regular expression of the datasets of these kinds, for a rule's wildcard constraint; matches nothing if there is none."""
    return "|".join(name for name, dataset in config["datasets"].items() if dataset["kind"] in kinds) or "(?!)"


def per_attempt(amount):
    """Memory or time for a step; as much more at every attempt, where a profile lets a job be submitted again."""
    return lambda wildcards, attempt: amount * attempt


def require_known(what, name, names, remedy):
    """`name`, or an error that lists the known names."""
    if name not in names:
        raise WorkflowError(name_error(what, name, names, remedy))
    return name


def dataset_named(name):
    """A dataset of the config, or an error that lists those that exist."""
    return config["datasets"][
        require_known("dataset", name, config["datasets"], "Datasets are listed in config/config.yaml under datasets.")
    ]


def objects_of(dataset):
    """The objects of a dataset: from the config, or for photos from the table."""
    if dataset_named(dataset)["kind"] == "photos":
        return [name for owner, name in PHOTOS if owner == dataset]
    if is_filmed(dataset):
        return [name for names in config["datasets"][dataset]["of"].values() for name in names]
    return config["datasets"][dataset]["objects"]


def is_virtual(dataset):
    """Whether a dataset has models, so that captures are rendered and the truth is known."""
    return dataset_named(dataset)["kind"] not in ("photos", "films")


def virtual_dataset(name, remedy=""):
    """`name`, or an error that lists the datasets that have models."""
    return require_known("virtual dataset", name, [dataset for dataset in config["datasets"] if is_virtual(dataset)], remedy)


def check_virtual_scene(wildcards):
    """Raise an error that lists the scenes where a path of a virtual dataset names an unknown one."""
    require_known("scene of a virtual dataset", wildcards.scene, VIRTUAL_SCENES, "")


def usable(what, name, table, remedy):
    """`name`, or an error where it is no method or lacks something here; `table` is one of zeroshop_steps.methods."""
    reason = methods.refusal(what, require_known(what, name, table, remedy), table)
    if reason:
        raise WorkflowError(reason)
    return name


def with_own_weights(stage, name, method):
    """A method of a stage, which lacks no weights where the config names some of the user's own."""
    return replace(method, weights=()) if config[stage].get(name, {}).get("weights") else method


def weights_stamp(stage, name, method):
    """Size and time of the files that a method of a stage reads its networks from: a parameter, so that other weights make its results stale.

    Not an input: Snakemake would delete and download weights again whenever their rule changes.
    """
    own = config[stage].get(name, {}).get("weights")
    files = [Path(os.path.relpath(ROOT / own))] if own else [methods.WEIGHTS_FOLDER / file for file in method.weights]
    return [f"{path} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in files if path.is_file()]


def registrations_of(dataset):
    """The registrations that make sense for a dataset: photos have no true cameras."""
    return {
        name: with_own_weights("register", name, method)
        for name, method in methods.REGISTRATIONS.items()
        if is_virtual(dataset) or not method.truth
    }


def check_object(wildcards):
    """Raise an error that lists what exists where a path names an unknown dataset or object."""
    names = objects_of(wildcards.dataset)
    where = config["objects_table"] if config["datasets"][wildcards.dataset]["kind"] == "photos" else "config/config.yaml"
    require_known(f"object of dataset {wildcards.dataset}", wildcards.object, names, f"Objects of this dataset are listed in {where}.")


def chosen_cell(wildcards):
    """The folder of the cell that the config chooses for an object."""
    check_object(wildcards)
    usable("nvs method", wildcards.nvs, methods.NVS, "The file is named after the method.")
    cell = config["chosen"]["virtual" if is_virtual(wildcards.dataset) else "photos"]
    return f"results/{wildcards.dataset}/{wildcards.object}/{cell['scene']}/{cell['registration']}/{wildcards.nvs}"


def capture_of(wildcards):
    """The capture that a registration reads, with every part of its path checked."""
    check_object(wildcards)
    virtual = is_virtual(wildcards.dataset)
    kind = "virtual" if virtual else "photo"
    require_known(f"scene of a {kind} dataset", wildcards.scene, [*VIRTUAL_SCENES, BOARD_SCENE] if virtual else PHOTO_SCENES, "")
    usable(
        f"registration of a {kind} dataset",
        wildcards.registration,
        registrations_of(wildcards.dataset),
        "" if virtual else "Photos have no true cameras.",
    )
    return f"results/{wildcards.dataset}/{wildcards.object}/{wildcards.scene}/capture"


def raw_mesh_of(wildcards):
    """The mesh that the nvs method of the path makes."""
    usable("nvs method", wildcards.nvs, methods.NVS, "The folder is named after the method.")
    folder = "results/{dataset}/{object}/{scene}/{registration}/{nvs}".format(**wildcards)
    return f"{folder}/raw_mesh.ply"


def step_options(options):
    """Config keys as command line options: `max_features: 4000` becomes `--max-features 4000`; a list its words; null leaves one out.

    Weights of the user's own lie where the config says, counted from the project's folder.
    """
    if options.get("weights"):
        options = {**options, "weights": shlex.quote(os.path.relpath(ROOT / options["weights"]))}
    words = {key: value if isinstance(value, list) else [value] for key, value in options.items() if value is not None}
    return " ".join(" ".join([f"--{key.replace('_', '-')}", *map(str, values)]) for key, values in words.items())


def registration_options(wildcards):
    """The options of the registration method in the path; the true cameras need none."""
    options = config["register"].get(wildcards.registration)
    return step_options({**options, "seed": config["seed"]}) if options else ""


def registration_needs(wildcards):
    """The method that the path names; an unknown one is refused where the capture is looked for."""
    return methods.REGISTRATIONS.get(wildcards.registration, methods.REGISTRATIONS["colmap"])


def registration_mem_mb(wildcards, attempt):
    """The memory that the registration method in the path may take; more where it was killed before."""
    return registration_needs(wildcards).mem_mb * attempt


def registration_runtime_min(wildcards, attempt):
    """The minutes that it may take."""
    return registration_needs(wildcards).runtime_min * attempt


def registration_gpus(wildcards):
    """The CUDA devices that it uses where there are any: one for a network."""
    return int(bool(registration_needs(wildcards).weights))


def registration_weights(wildcards):
    """What its networks are read from."""
    return weights_stamp("register", wildcards.registration, registration_needs(wildcards))


def environment_of(options):
    """An input function: the environment that the renderer in a part of the config needs, if it needs one."""
    return lambda wildcards: [BLENDER_RECORD] if options["renderer"] == "blenderproc" else []


def environment_option(wildcards, input):
    """The option that names this environment."""
    return step_options({"environment": str(input.environment) or None})


def capture_renderer_options(wildcards, input):
    """The options of the renderer of captures that not every renderer has."""
    samples = config["capture"]["samples"] if input.environment else None
    return f"{step_options({'samples': samples})} {environment_option(wildcards, input)}".strip()


def models_option(wildcards):
    """The option that names a local folder of BOP models, if the config does."""
    folder = config["datasets"][wildcards.dataset]["models_folder"]
    return step_options({"models": folder and shlex.quote(os.path.relpath(ROOT / folder))})


def checked_object(wildcards):
    """The object in a path, or an error that lists the objects of its dataset."""
    check_object(wildcards)
    return wildcards.object


def chosen_mesh(wildcards):
    """The finished mesh of the chosen cell."""
    return f"{chosen_cell(wildcards)}/mesh.ply"


def chosen_companions(wildcards):
    """What lies beside the finished mesh and goes with it."""
    return [f"{chosen_cell(wildcards)}/mesh.{suffix}" for suffix in ("png", "glb", "json")]


def quality_option(wildcards, input):
    """The option that adds the quality to a product's JSON, where there is a truth to measure against."""
    return step_options({"quality": " ".join(input.quality) or None})


def chosen_preview(wildcards):
    """The preview of the chosen cell."""
    return f"{chosen_cell(wildcards)}/mesh_preview.png"


def chosen_quality(wildcards):
    """The quality of the chosen cell, where there is a truth to measure against."""
    cell = chosen_cell(wildcards)
    return [f"{cell}/quality.json"] if is_virtual(wildcards.dataset) else []


def chosen_grade(wildcards):
    """The grade of the chosen cell."""
    return f"{chosen_cell(wildcards)}/grade.json"


def chosen_evidence(wildcards):
    """What of the chosen mesh was measured."""
    return f"{chosen_cell(wildcards)}/evidence.npz"


def quality_of(wildcards):
    """The quality of a cell, where there is a truth to measure against."""
    folder = "results/{dataset}/{object}/{scene}/{registration}/{nvs}".format(**wildcards)
    return [f"{folder}/quality.json"] if is_virtual(wildcards.dataset) else []


def stage_facts(wildcards):
    """The records of the stages behind a mesh, for its JSON."""
    training = TRAINING_RECORDS[require_known("nvs method", wildcards.nvs, TRAINING_RECORDS, "The folder is named after the method.")]
    folder = "results/{dataset}/{object}/{scene}/{registration}/{nvs}".format(**wildcards)
    stereo = "results/{dataset}/{object}/{scene}/{registration}/stereo/stereo.json".format(**wildcards)
    steps = (training, "raw_mesh", "clean", "height", "underside", "unwrapped", "texture")
    return [stereo, *(f"{folder}/{name}.json" for name in steps)]
