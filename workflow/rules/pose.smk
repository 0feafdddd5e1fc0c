"""Pose: estimates in a dataset's test set with its true or reconstructed models.

results/DATASET/bop/ESTIMATOR-MASKS-MODELS/poses.csv   MASKS: truth, or the detector that found the masks (detect.smk);
                                                       MODELS: models or models_NVS (bop.smk); scores.csv beside it scores it
results/DATASET/bop/ESTIMATOR-MASKS-MODELS/pictures    the poses over the images, and the ten worst
"""

POSES = f"{BOP}/{{estimator}}-{{masks}}-{{models}}"
TESTED = {"models": f"{BOP}/{{models}}", "scenes": f"{BOP}/test", "targets": f"{BOP}/test_targets_bop19.json"}
RUNS = {"estimator": "|".join(plan.estimators), "masks": "|".join(["truth", *plan.all_detectors]), "models": MODELS}


rule estimate_poses:
    input:
        **TESTED,
        templates=plan.templates,
        detections=plan.detections,
    output:
        estimates=f"{POSES}/poses.csv",
    log:
        f"{POSES}/logs/poses.log",
    wildcard_constraints:
        **RUNS,
    threads: lambda wildcards: plan.estimator(wildcards).threads
    resources:
        **needs_of("pose", plan.estimator),
    params:
        options=lambda wildcards: step_options(plan.section("pose", wildcards.estimator)),
        inputs=given(),
        weights=lambda wildcards: plan.weights_stamp("pose", plan.estimator(wildcards)),
    message:
        "Estimating poses with the {wildcards.models} of {wildcards.dataset} by {wildcards.estimator}, masks by {wildcards.masks}"
    shell:
        "python -m zeroshop_steps.pose --method {wildcards.estimator} {params.options} {params.inputs} --out {output.estimates}"
        f"{RECORDED}"
        " > {log} 2>&1"


rule pose_pictures:
    input:
        **TESTED,
        detections=plan.detections,
        estimates=f"{POSES}/poses.csv",
        errors=f"{POSES}/errors.csv",
    output:
        pictures=directory(f"{POSES}/pictures"),
    log:
        f"{POSES}/logs/pictures.log",
    wildcard_constraints:
        **RUNS,
    resources:
        **needs(2000, 30),
    params:
        inputs=given(),
    message:
        "Drawing the poses of {wildcards.estimator}, masks by {wildcards.masks}, with the {wildcards.models} of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method pictures {params.inputs} --out {output.pictures} > {log} 2>&1"
