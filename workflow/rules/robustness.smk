"""Robustness: what poses lose with models of a wrong scale, or without the underside, which a film from around does not show.

results/DATASET/bop/models_scaled_plus_5, models_without_underside   true models, damaged on purpose
results/DATASET/tables/robustness.csv, robustness.svg                AR of poses from true masks with them
"""

SCALE_ERRORS_PERCENT = (-10, -5, -2, 2, 5, 10)
DAMAGES = {
    **{f"scaled_{'minus' if error < 0 else 'plus'}_{abs(error)}": f"--scale-percent {error}" for error in SCALE_ERRORS_PERCENT},
    "without_underside": "--open-underside",
}
DAMAGED = "|".join(DAMAGES)


def scores_of_robustness(
    wildcards,
):
    """The scores of poses from true masks with the true models and with damaged ones."""
    virtual_dataset(wildcards.dataset, "Photos have no test set.")
    folders = ["models", *(f"models_{damage}" for damage in DAMAGES)]
    estimator = table_axis("estimators")[0]
    return [f"{BOP}/{estimator}-truth-{models}/scores.csv".format(**wildcards) for models in folders]


localrules:
    robustness_table,


rule damaged_models:
    input:
        models=f"{BOP}/models",
    output:
        models=directory(f"{BOP}/models_{{damage}}"),
    log:
        f"{BOP}/logs/models_{{damage}}.log",
    benchmark:
        f"{BOP}/benchmarks/models_{{damage}}.tsv"
    wildcard_constraints:
        damage=DAMAGED,
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(20),
    params:
        damage=lambda wildcards: DAMAGES[wildcards.damage],
    message:
        "Damaging the true models of {wildcards.dataset}: {wildcards.damage}"
    shell:
        "python -m zeroshop_steps.bop --method damage_models --models {input.models} {params.damage} --out {output.models}"
        f"{RECORDED_FOLDER}"
        " > {log} 2>&1"


rule robustness_table:
    input:
        scores=scores_of_robustness,
    output:
        table=f"{TABLES}/robustness.csv",
        plot=report(
            f"{TABLES}/robustness.svg",
            caption="../report/robustness.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "robustness of poses"},
        ),
        picture=f"{TABLES}/robustness.png",
    log:
        f"{TABLES}/logs/robustness.log",
    benchmark:
        f"{TABLES}/benchmarks/robustness.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Gathering what poses of {wildcards.dataset} lose with damaged models"
    shell:
        "python -m zeroshop_steps.report --method robustness --scores {input.scores} --out {output.table} > {log} 2>&1"
