"""Pose: estimates in a dataset's test set with its true or reconstructed models.

results/DATASET/bop/ESTIMATOR-MASKS-MODELS/poses.csv   MASKS: truth, or the detector that found the masks (detect.smk);
                                                       MODELS: models or models_NVS (bop.smk); scores.csv beside it scores it
results/DATASET/bop/ESTIMATOR-MASKS-MODELS/pictures    the poses over the images, and the ten worst
"""


rule estimate_poses:
    input:
        models="results/{dataset}/bop/{models}",
        scenes="results/{dataset}/bop/test",
        targets="results/{dataset}/bop/test_targets_bop19.json",
        detections=detections_of,
    output:
        estimates="results/{dataset}/bop/{estimator}-{masks}-{models}/poses.csv",
    log:
        "results/{dataset}/bop/{estimator}-{masks}-{models}/logs/poses.log",
    benchmark:
        "results/{dataset}/bop/{estimator}-{masks}-{models}/benchmarks/poses.tsv"
    wildcard_constraints:
        estimator="|".join(methods.ESTIMATORS),
        masks="|".join(["truth", *methods.DETECTORS]),
        models=r"models(_[^/.]+)?",
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(120),
    params:
        detections=detections_option,
    message:
        "Estimating poses with the {wildcards.models} of {wildcards.dataset} by {wildcards.estimator}, masks by {wildcards.masks}"
    shell:
        "python -m zeroshop_steps.pose --method {wildcards.estimator} --models {input.models} --scenes {input.scenes}"
        " --targets {input.targets} {params.detections} --out {output.estimates} > {log} 2>&1"


rule pose_pictures:
    input:
        models="results/{dataset}/bop/{models}",
        scenes="results/{dataset}/bop/test",
        targets="results/{dataset}/bop/test_targets_bop19.json",
        estimates="results/{dataset}/bop/{estimator}-{masks}-{models}/poses.csv",
        errors="results/{dataset}/bop/{estimator}-{masks}-{models}/errors.csv",
        detections=detections_of,
    output:
        pictures=directory("results/{dataset}/bop/{estimator}-{masks}-{models}/pictures"),
    log:
        "results/{dataset}/bop/{estimator}-{masks}-{models}/logs/pictures.log",
    benchmark:
        "results/{dataset}/bop/{estimator}-{masks}-{models}/benchmarks/pictures.tsv"
    wildcard_constraints:
        estimator="|".join(methods.ESTIMATORS),
        masks="|".join(["truth", *methods.DETECTORS]),
        models=r"models(_[^/.]+)?",
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
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
