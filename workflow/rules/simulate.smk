"""Simulate: a robot that knows a dataset's meshes grasps the true objects (the thesis's protocol, 4.4.3).

results/DATASET/OBJECT/body.npz                       the true object in convex parts, with its true mass
results/DATASET/OBJECT/grasp_protocol                 its first images in the eight poses, a scene in BOP's layout
results/DATASET/bop/models_delivered_NVS              the chosen cells' meshes as they were made, in their own frames and scales
results/DATASET/bop/grasping/MODELS/OBJECT/attempts.csv   eight poses, with the usual friction and half of it; failures/ has pictures
results/DATASET/tables/grasp.csv, grasp.md            the thesis's Table 4.6 in simulation
MODELS: models (true), models_delivered_NVS, or true ones damaged on purpose (robustness.smk)
"""

GRASPING = f"{BOP}/grasping/{{models}}"


def mass_option(
    wildcards,
):
    """The option that gives an object's mass, where the config names one."""
    mass_kg = config["simulate"]["mass_kg"].get(f"{wildcards.dataset}/{wildcards.object}")
    return step_options({"mass_kg": mass_kg})


def alignment_of(
    wildcards,
):
    """The alignment of the robot's mesh with the true model; none where it is the true one, damaged or not."""
    nvs = wildcards.models.removeprefix("models_delivered_")
    return [] if nvs == wildcards.models else f"{chosen_cell_of(wildcards, nvs)}/aligned.json"


def chosen_cell_of(wildcards, nvs):
    """The folder of an object's chosen cell."""
    chosen = config["chosen"]["virtual"]
    return CELL.format(dataset=wildcards.dataset, object=wildcards.object, nvs=nvs, **chosen)


rule physical_model:
    input:
        model=f"{OBJECT}/model",
    output:
        body=f"{OBJECT}/body.npz",
    log:
        f"{OBJECT}/logs/body.log",
    benchmark:
        f"{OBJECT}/benchmarks/body.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(10),
    params:
        mass=mass_option,
    message:
        "Splitting the true model of {wildcards.dataset} {wildcards.object} into convex parts"
    shell:
        "python -m zeroshop_steps.simulate --method physical_model --model {input.model}/model.ply"
        " --object {wildcards.dataset}/{wildcards.object} {params.mass} --out {output.body} > {log} 2>&1"


use rule reconstructed_models as delivered_models with:
    output:
        models=directory(f"{BOP}/models_delivered_{{nvs}}"),
    log:
        f"{BOP}/logs/models_delivered_{{nvs}}.log",
    benchmark:
        f"{BOP}/benchmarks/models_delivered_{{nvs}}.tsv"
    params:
        frames="--own-frames",
    message:
        "Gathering the models of {wildcards.dataset} that {wildcards.nvs} made, as a robot gets them"


rule protocol_images:
    input:
        model=f"{OBJECT}/model",
        body=f"{OBJECT}/body.npz",
    output:
        images=directory(f"{OBJECT}/grasp_protocol"),
    log:
        f"{OBJECT}/logs/grasp_protocol.log",
    benchmark:
        f"{OBJECT}/benchmarks/grasp_protocol.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    threads: 2
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        seed=config["seed"],
    message:
        "Photographing {wildcards.dataset} {wildcards.object} in the eight poses of the grasp protocol"
    shell:
        "python -m zeroshop_steps.simulate --method protocol_images --model {input.model} --body {input.body} --seed {params.seed}"
        " --threads {threads} --out {output.images} > {log} 2>&1"


rule grasp_attempts:
    input:
        model=f"{OBJECT}/model",
        body=f"{OBJECT}/body.npz",
        images=f"{OBJECT}/grasp_protocol",
        models=f"{BOP}/{{models}}",
        templates=f"{BOP}/templates/{{models}}/42",
        aligned=alignment_of,
    output:
        attempts=directory(f"{GRASPING}/{{object}}"),
    log:
        f"{GRASPING}/logs/{{object}}.log",
    benchmark:
        f"{GRASPING}/benchmarks/{{object}}.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
        models=MODELS,
    threads: 2
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(60),
    params:
        options=lambda wildcards: step_options({key: config["simulate"][key] for key in ("gripper", "friction")}),
        aligned=lambda wildcards, input: step_options({"aligned": input.get("aligned") or None}),
        seed=config["seed"],
    message:
        "Grasping {wildcards.object} of {wildcards.dataset}, known by its mesh in {wildcards.models}"
    shell:
        "python -m zeroshop_steps.simulate --method attempts --model {input.model} --body {input.body} --images {input.images}"
        " --models {input.models} --templates {input.templates} {params.aligned} {params.options} --seed {params.seed} --threads {threads}"
        " --out {output.attempts} > {log} 2>&1"
