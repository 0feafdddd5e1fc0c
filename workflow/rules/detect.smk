"""Detect: views of the models from all sides, and what detectors find with them in a dataset's test set.

results/DATASET/bop/templates/MODELS/VIEWS           MODELS: models or models_NVS (bop.smk); VIEWS: 42 or 642
results/DATASET/bop/DETECTOR-MODELS/detections.json  DETECTOR: contour or cnos; precision.csv beside it scores it (bop.smk)
results/DATASET/bop/DETECTOR-MODELS/masks.json       the sure ones, without overlap: what poses are estimated from after CNOS
"""


rule templates:
    input:
        models="results/{dataset}/bop/{models}",
    output:
        templates=directory("results/{dataset}/bop/templates/{models}/{views}"),
    log:
        "results/{dataset}/bop/logs/templates_{models}_{views}.log",
    benchmark:
        "results/{dataset}/bop/benchmarks/templates_{models}_{views}.tsv"
    wildcard_constraints:
        models=r"models(_[^/.]+)?",
        views="42|642",
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(30),
    message:
        "Rendering the {wildcards.models} of {wildcards.dataset} from {wildcards.views} sides"
    shell:
        "python -m zeroshop_steps.detect --method templates --models {input.models} --views {wildcards.views}"
        " --out {output.templates} > {log} 2>&1"


rule contour:
    input:
        models="results/{dataset}/bop/{models}",
        templates="results/{dataset}/bop/templates/{models}/42",
        scenes="results/{dataset}/bop/test",
        targets="results/{dataset}/bop/test_targets_bop19.json",
    output:
        detections="results/{dataset}/bop/contour-{models}/detections.json",
    log:
        "results/{dataset}/bop/contour-{models}/logs/detections.log",
    benchmark:
        "results/{dataset}/bop/contour-{models}/benchmarks/detections.tsv"
    wildcard_constraints:
        models=r"models(_[^/.]+)?",
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(60),
    message:
        "Looking for the {wildcards.models} of {wildcards.dataset} by contours"
    shell:
        "python -m zeroshop_steps.detect --method contour --models {input.models} --templates {input.templates}"
        " --scenes {input.scenes} --targets {input.targets} --out {output.detections} > {log} 2>&1"


rule cnos:
    input:
        models="results/{dataset}/bop/{models}",
        templates="results/{dataset}/bop/templates/{models}/42",
        scenes="results/{dataset}/bop/test",
        targets="results/{dataset}/bop/test_targets_bop19.json",
        weights=detector_weights("cnos"),
    output:
        detections="results/{dataset}/bop/cnos-{models}/detections.json",
    log:
        "results/{dataset}/bop/cnos-{models}/logs/detections.log",
    benchmark:
        "results/{dataset}/bop/cnos-{models}/benchmarks/detections.tsv"
    wildcard_constraints:
        models=r"models(_[^/.]+)?",
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=per_attempt(12000),
        runtime=per_attempt(240),
        gpu=1,
    message:
        "Looking for the {wildcards.models} of {wildcards.dataset} by CNOS"
    shell:
        "python -m zeroshop_steps.detect --method cnos --models {input.models} --templates {input.templates}"
        " --scenes {input.scenes} --targets {input.targets} --out {output.detections} > {log} 2>&1"


rule filter_masks:
    input:
        detections="results/{dataset}/bop/{detector}-{models}/detections.json",
        models="results/{dataset}/bop/{models}",
    output:
        masks="results/{dataset}/bop/{detector}-{models}/masks.json",
    log:
        "results/{dataset}/bop/{detector}-{models}/logs/masks.log",
    benchmark:
        "results/{dataset}/bop/{detector}-{models}/benchmarks/masks.tsv"
    wildcard_constraints:
        detector="|".join(methods.DETECTORS),
        models=r"models(_[^/.]+)?",
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(10),
    message:
        "Choosing masks for poses of the {wildcards.models} of {wildcards.dataset}, found by {wildcards.detector}"
    shell:
        "python -m zeroshop_steps.detect --method filter_masks --detections {input.detections} --models {input.models}"
        " --out {output.masks} > {log} 2>&1"
