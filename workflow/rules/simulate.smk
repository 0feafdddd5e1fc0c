"""Simulate: a robot that knows a dataset's meshes grasps the true objects (the thesis's protocol, 4.4.3).

results/DATASET/OBJECT/body.npz                       the true object in convex parts, with its true mass
results/DATASET/OBJECT/grasp_protocol                 its first images in the eight poses, a scene in BOP's layout
results/DATASET/bop/models_delivered_NVS              the chosen cells' meshes as they were made, in their own frames and scales
results/DATASET/bop/models_misjudged_NVS              the same, each as much too large or small as the height that the thesis published of it
results/DATASET/bop/grasping/MODELS/OBJECT/attempts.csv   eight poses, with the usual friction and half of it; failures/ has pictures
results/DATASET/bop/grasp_scenes                      several things on a table, clear and overlapping
results/DATASET/bop/sightings/MODELS                  what the robot makes of them
MODELS: models (true), models_delivered_NVS, models_misjudged_NVS, or true ones damaged on purpose (robustness.smk)
"""

from zeroshop_steps.report.heights import read_published_heights

GRASPING = f"{BOP}/grasping/{{models}}"
SIGHTINGS = f"{BOP}/sightings/{{models}}"


def mass_option(
    wildcards,
):
    """The option that gives an object's mass, where the config names one."""
    mass_kg = config["simulate"]["mass_kg"].get(f"{wildcards.dataset}/{wildcards.object}")
    return step_options({"mass_kg": mass_kg})


def aligned_mesh(
    dataset,
    name,
    models,
):
    """The alignment of the robot's mesh of an object with the true model, in a list; an empty one where it is true, damaged or not."""
    nvs = models.removeprefix("models_delivered_").removeprefix("models_misjudged_")
    cell = {"dataset": dataset, "object": name, "nvs": nvs, **config["chosen"]["virtual"]}
    return [] if nvs == models else [f"{CELL}/aligned.json".format(**cell)]


def alignment_of(
    wildcards,
):
    """The same for one object."""
    return aligned_mesh(wildcards.dataset, wildcards.object, wildcards.models)


def alignments_of(
    wildcards,
):
    """The same for all objects of a dataset."""
    return [path for name in objects_of(wildcards.dataset) for path in aligned_mesh(wildcards.dataset, name, wildcards.models)]


def published_errors(
    dataset,
):
    """Errors in per cent of the heights that the thesis estimated for a dataset's objects, by object: there are some of YCB-V."""
    known = {found.ycbv_object: found.difference_percent for found in read_published_heights()} if dataset == "ycbv" else {}
    return {name: known[name] for name in objects_of(dataset) if name in known}


def errors_of_heights(
    wildcards,
):
    """The option that gives the model of each of these objects such an error; those of the others stay as they are."""
    errors = published_errors(wildcards.dataset)
    return "--scale-percent-of " + " ".join(f"{int(name.removeprefix('obj_'))}={percent}" for name, percent in errors.items())


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


use rule damaged_models as misjudged_models with:
    input:
        models=f"{BOP}/models_delivered_{{nvs}}",
    output:
        models=directory(f"{BOP}/models_misjudged_{{nvs}}"),
    log:
        f"{BOP}/logs/models_misjudged_{{nvs}}.log",
    benchmark:
        f"{BOP}/benchmarks/models_misjudged_{{nvs}}.tsv"
    params:
        damage=errors_of_heights,
    message:
        "Giving the models of {wildcards.dataset} that {wildcards.nvs} made the errors of the thesis's heights"


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
        " --out {output.attempts}"
        f"{RECORDED_FOLDER}"
        " > {log} 2>&1"


rule grasp_scenes:
    input:
        models=f"{BOP}/models",
    output:
        scenes=directory(f"{BOP}/grasp_scenes"),
    log:
        f"{BOP}/logs/grasp_scenes.log",
    benchmark:
        f"{BOP}/benchmarks/grasp_scenes.tsv"
    threads: 2
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(20),
    params:
        counts=step_options({key: config["simulate"][key] for key in ("clear_scenes", "overlapping_scenes")}),
        seed=config["seed"],
    message:
        "Photographing several things of {wildcards.dataset} on a table"
    shell:
        "python -m zeroshop_steps.simulate --method scenes --models {input.models} {params.counts} --seed {params.seed} --threads {threads}"
        " --out {output.scenes} > {log} 2>&1"


rule sightings:
    input:
        scenes=f"{BOP}/grasp_scenes",
        truth=f"{BOP}/models",
        models=f"{BOP}/{{models}}",
        templates=f"{BOP}/templates/{{models}}/42",
        aligned=alignments_of,
    output:
        sightings=directory(SIGHTINGS),
    log:
        f"{BOP}/sightings/logs/{{models}}.log",
    benchmark:
        f"{BOP}/sightings/benchmarks/{{models}}.tsv"
    wildcard_constraints:
        models=MODELS,
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(30),
    params:
        aligned=lambda wildcards, input: step_options({"aligned": list(input.get("aligned")) or None}),
    message:
        "Looking at several things of {wildcards.dataset}, known by their meshes in {wildcards.models}"
    shell:
        "python -m zeroshop_steps.simulate --method sightings --scenes {input.scenes} --truth {input.truth} --models {input.models}"
        " --templates {input.templates} {params.aligned} --out {output.sightings}"
        f"{RECORDED_FOLDER}"
        " > {log} 2>&1"
