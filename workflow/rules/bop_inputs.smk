"""What BOP's steps read: models, detections, and the scores that its table gathers."""


def true_models_of(wildcards):
    """The true models of a dataset's objects."""
    virtual_dataset(wildcards.dataset, "Photos have no true models.")
    return [f"results/{wildcards.dataset}/{name}/model" for name in objects_of(wildcards.dataset)]


def training_captures_of(wildcards):
    """The captures of a dataset's objects in a scene."""
    check_virtual_scene(wildcards)
    return [f"{Path(model).parent}/{wildcards.scene}/capture" for model in true_models_of(wildcards)]


def alignments_of(wildcards):
    """How the mesh of the chosen cell of each object lies on its true model."""
    return in_chosen_cells(wildcards, "aligned.json")


def evidence_of(wildcards):
    """What of these meshes was measured."""
    return in_chosen_cells(wildcards, "evidence.npz")


def in_chosen_cells(wildcards, name):
    """A file of the chosen cell of each object of a dataset."""
    usable("nvs method", wildcards.nvs, methods.NVS, "The folder is named after the method.")
    chosen = config["chosen"]["virtual"]
    cells = cells_of(wildcards.dataset, objects_of(wildcards.dataset), [chosen["scene"]], [chosen["registration"]], [wildcards.nvs])
    return [f"{CELL}/{name}".format(**cell) for cell in cells]


def mesh_or_failure_of(wildcards):
    """The finished mesh of a cell; of one that failed, the record of its failure."""
    outcome = checkpoints.outcome.get(**wildcards).output.outcome
    return outcome if failures.read_failure(outcome) else f"{CELL}/mesh.ply".format(**wildcards)


def detections_of(wildcards):
    """The detections that poses are estimated from; none where the masks are the true ones."""
    usable("pose estimator", wildcards.estimator, methods.ESTIMATORS, "The folder is named ESTIMATOR-MASKS-MODELS.")
    if wildcards.masks == "truth":
        return []
    usable("detector", wildcards.masks, methods.DETECTORS, "The folder is named ESTIMATOR-MASKS-MODELS.")
    return f"results/{wildcards.dataset}/bop/{wildcards.masks}-{wildcards.models}/{methods.DETECTORS[wildcards.masks].masks}"


def detections_option(wildcards, input):
    """The option that names the detections, where the masks are not the true ones."""
    return step_options({"detections": input.get("detections") or None})


def scores_of_table(wildcards):
    """The scores of every detector and estimator that the config wants in tables, with true and with reconstructed models."""
    virtual_dataset(wildcards.dataset, "Photos have no test set.")
    say_what_is_left_out("nvs", "detectors", "estimators")
    detectors, estimators = table_axis("detectors"), table_axis("estimators")
    runs = [f"{detector}-MODELS/precision" for detector in detectors]
    runs += [f"{estimator}-{masks}-MODELS/scores" for estimator in estimators for masks in ["truth", *detectors]]
    folders = ["models", *(f"models_{nvs}" for nvs in table_axis("nvs"))]
    return [f"results/{wildcards.dataset}/bop/{run.replace('MODELS', models)}.csv" for models in folders for run in runs]


def detector_weights(name):
    """An input function: the weights of a detector, or an error that says how to get them."""

    def weights(wildcards):
        usable("detector", name, methods.DETECTORS, "The folder is named after the detector.")
        return [str(methods.WEIGHTS_FOLDER / file) for file in methods.DETECTORS[name].weights]

    return weights
