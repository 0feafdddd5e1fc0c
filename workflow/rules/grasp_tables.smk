"""Tables and plots of grasps in simulation (simulate.smk).

results/DATASET/tables/grasp.csv, grasp.md            the thesis's Table 4.6 in simulation; for YCB-V also with heights as wrong as published
results/DATASET/tables/grasp_scenes.csv               the scenes of several things alone
results/DATASET/tables/grasp_robustness.csv           attempts with true models of a wrong scale, or without the underside
results/DATASET/tables/grasp_scale.svg, grasp_underside.svg   its two plots
"""


def robots_of(
    dataset,
):
    """The folders of models that robots know in the table: the true ones, and those of every surface method that measures.

    The latter also with the errors of the heights that the thesis published, where it published some of these objects.
    """
    virtual_dataset(dataset, "Photos have no true models.")
    kinds = ["delivered", "misjudged"] if published_errors(dataset) else ["delivered"]
    return ["models", *(f"models_{kind}_{nvs}" for kind in kinds for nvs in measured_surfaces("the table of grasps"))]


def attempts_of_table(
    wildcards,
):
    """The attempts with every object of a dataset, by every robot; by those with wrong heights, with the objects that these are of."""
    names, wrong = objects_of(wildcards.dataset), published_errors(wildcards.dataset)
    robots = {models: wrong if "_misjudged_" in models else names for models in robots_of(wildcards.dataset)}
    return [f"{GRASPING}/{name}".format(dataset=wildcards.dataset, models=models) for models, own in robots.items() for name in own]


def sightings_of_table(
    wildcards,
):
    """What every robot makes of several things on a table."""
    return [SIGHTINGS.format(dataset=wildcards.dataset, models=models) for models in robots_of(wildcards.dataset)]


def attempts_of_robustness(
    wildcards,
):
    """The attempts with every object of a dataset, by robots that know true models or damaged ones."""
    virtual_dataset(wildcards.dataset, "Photos have no true models.")
    robots = ["models", *(f"models_{damage}" for damage in DAMAGES)]
    names = objects_of(wildcards.dataset)
    return [f"{GRASPING}/{name}".format(dataset=wildcards.dataset, models=models) for models in robots for name in names]


localrules:
    grasp_table,
    grasp_scenes_table,
    grasp_robustness_table,


rule grasp_table:
    input:
        attempts=attempts_of_table,
        scenes=sightings_of_table,
    output:
        table=f"{TABLES}/grasp.csv",
        page=report(
            f"{TABLES}/grasp.md",
            caption="../report/grasp.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "grasps in simulation"},
        ),
    log:
        f"{TABLES}/logs/grasp.log",
    benchmark:
        f"{TABLES}/benchmarks/grasp.tsv"
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Gathering the grasps of {wildcards.dataset} in simulation"
    shell:
        "python -m zeroshop_steps.report --method grasping --attempts {input.attempts} --scenes {input.scenes} --page {output.page}"
        " --out {output.table} > {log} 2>&1"


rule grasp_scenes_table:
    input:
        scenes=sightings_of_table,
    output:
        table=f"{TABLES}/grasp_scenes.csv",
    log:
        f"{TABLES}/logs/grasp_scenes.log",
    benchmark:
        f"{TABLES}/benchmarks/grasp_scenes.tsv"
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Gathering what robots make of several things of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method grasp_scenes --scenes {input.scenes} --out {output.table} > {log} 2>&1"


rule grasp_robustness_table:
    input:
        attempts=attempts_of_robustness,
    output:
        table=f"{TABLES}/grasp_robustness.csv",
        scale=report(
            f"{TABLES}/grasp_scale.svg",
            caption="../report/grasp.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "grasps with a wrong scale"},
        ),
        underside=report(
            f"{TABLES}/grasp_underside.svg",
            caption="../report/grasp.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "grasps without the underside"},
        ),
        pictures=[f"{TABLES}/grasp_scale.png", f"{TABLES}/grasp_underside.png"],
    log:
        f"{TABLES}/logs/grasp_robustness.log",
    benchmark:
        f"{TABLES}/benchmarks/grasp_robustness.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Gathering how grasps of {wildcards.dataset} fail with damaged models"
    shell:
        "python -m zeroshop_steps.report --method grasp_robustness --attempts {input.attempts} --out {output.table}"
        " --scale-plot {output.scale} --underside-plot {output.underside} > {log} 2>&1"
