"""Pose: estimates in a dataset's test set with its true or reconstructed models, from true masks.

results/DATASET/bop/render_compare-MODELS/poses.csv   MODELS: models or models_NVS (bop.smk); scores.csv beside it scores it
"""


rule render_compare:
    input:
        models="results/{dataset}/bop/{models}",
        scenes="results/{dataset}/bop/test",
        targets="results/{dataset}/bop/test_targets_bop19.json",
    output:
        estimates="results/{dataset}/bop/render_compare-{models}/poses.csv",
    log:
        "results/{dataset}/bop/render_compare-{models}/logs/poses.log",
    benchmark:
        "results/{dataset}/bop/render_compare-{models}/benchmarks/poses.tsv"
    wildcard_constraints:
        models=r"models(_[^/.]+)?",
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=3000,
        runtime=120,
    message:
        "Estimating poses with the {wildcards.models} of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.pose --method render_compare --models {input.models} --scenes {input.scenes} --targets {input.targets}"
        " --out {output.estimates} > {log} 2>&1"
