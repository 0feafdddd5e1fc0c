"""Detect: views of the models from all sides, which detectors and pose estimators compare with.

results/DATASET/bop/templates/MODELS/VIEWS   MODELS: models or models_NVS (bop.smk); VIEWS: 42 or 642
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
        mem_mb=4000,
        runtime=30,
    message:
        "Rendering the {wildcards.models} of {wildcards.dataset} from {wildcards.views} sides"
    shell:
        "python -m zeroshop_steps.detect --method templates --models {input.models} --views {wildcards.views}"
        " --out {output.templates} > {log} 2>&1"
