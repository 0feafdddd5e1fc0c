"""Pose: estimates in a dataset's test set with its true or reconstructed models.

results/DATASET/bop/ESTIMATOR-MASKS-MODELS/poses.csv   MASKS: truth, or the detector that found the masks (detect.smk);
                                                       MODELS: models or models_NVS (bop.smk); scores.csv beside it scores it
results/DATASET/bop/ESTIMATOR-MASKS-MODELS/pictures    the poses over the images, and the ten worst
"""

POSES = f"{BOP}/{{estimator}}-{{masks}}-{{models}}"


def detections_of(
    wildcards,
):
    """The detections that poses are estimated from; none where the masks are the true ones."""
    usable("pose estimator", wildcards.estimator, ESTIMATORS, "The folder is named ESTIMATOR-MASKS-MODELS.")
    if wildcards.masks == "truth":
        return []
    usable("detector", wildcards.masks, ALL_DETECTORS, "The folder is named ESTIMATOR-MASKS-MODELS.")
    return f"{RESULTS}/{wildcards.dataset}/bop/{wildcards.masks}-{wildcards.models}/{ALL_DETECTORS[wildcards.masks].masks}"


def detections_option(
    wildcards,
    input,
):
    """The option that names the detections, where the masks are not the true ones."""
    return step_options({"detections": input.get("detections") or None})


def templates_of(
    wildcards,
):
    """The views of the models, for an estimator that reads them."""
    return f"{BOP}/templates/{wildcards.models}/42".format(**wildcards) if ESTIMATORS[wildcards.estimator].templates else []


def estimator_options(
    wildcards,
):
    """The options of an estimator that the config gives."""
    return step_options(config["pose"].get(wildcards.estimator) or {})


def estimator_inputs(
    wildcards,
    input,
):
    """The options that name its views and masks."""
    return step_options({"templates": input.get("templates") or None, "detections": input.get("detections") or None})


def of_estimator(
    amount,
):
    """Memory or time that an estimator declares, more at each attempt."""
    return lambda wildcards, attempt: attempt * getattr(ESTIMATORS[wildcards.estimator], amount)


rule estimate_poses:
    input:
        models=f"{BOP}/{{models}}",
        templates=templates_of,
        scenes=f"{BOP}/test",
        targets=f"{BOP}/test_targets_bop19.json",
        detections=detections_of,
    output:
        estimates=f"{POSES}/poses.csv",
    log:
        f"{POSES}/logs/poses.log",
    benchmark:
        f"{POSES}/benchmarks/poses.tsv"
    wildcard_constraints:
        estimator="|".join(ESTIMATORS),
        masks="|".join(["truth", *ALL_DETECTORS]),
        models=MODELS,
    threads: lambda wildcards: ESTIMATORS[wildcards.estimator].threads
    resources:
        mem_mb=of_estimator("mem_mb"),
        runtime=of_estimator("runtime_min"),
        gpu=gpu_of("pose", lambda wildcards: ESTIMATORS[wildcards.estimator]),
        gpu_mem_mb=gpu_mem_of("pose", lambda wildcards: ESTIMATORS[wildcards.estimator]),
    params:
        options=estimator_options,
        inputs=estimator_inputs,
        weights=lambda wildcards: weights_stamp("pose", wildcards.estimator, ESTIMATORS[wildcards.estimator]),
    message:
        "Estimating poses with the {wildcards.models} of {wildcards.dataset} by {wildcards.estimator}, masks by {wildcards.masks}"
    shell:
        "python -m zeroshop_steps.pose --method {wildcards.estimator} --models {input.models} --scenes {input.scenes}"
        " --targets {input.targets} {params.options} {params.inputs} --out {output.estimates}"
        f"{RECORDED}"
        " > {log} 2>&1"


rule pose_pictures:
    input:
        models=f"{BOP}/{{models}}",
        scenes=f"{BOP}/test",
        targets=f"{BOP}/test_targets_bop19.json",
        estimates=f"{POSES}/poses.csv",
        errors=f"{POSES}/errors.csv",
        detections=detections_of,
    output:
        pictures=directory(f"{POSES}/pictures"),
    log:
        f"{POSES}/logs/pictures.log",
    benchmark:
        f"{POSES}/benchmarks/pictures.tsv"
    wildcard_constraints:
        estimator="|".join(ESTIMATORS),
        masks="|".join(["truth", *ALL_DETECTORS]),
        models=MODELS,
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(30),
    params:
        detections=detections_option,
    message:
        "Drawing the poses of {wildcards.estimator}, masks by {wildcards.masks}, with the {wildcards.models} of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method pictures --models {input.models} --scenes {input.scenes} --targets {input.targets}"
        " {params.detections} --estimates {input.estimates} --errors {input.errors} --out {output.pictures} > {log} 2>&1"
