"""Simulate: a robot that knows a dataset's meshes grasps the true objects (the thesis's protocol, 4.4.3).

results/DATASET/OBJECT/body.npz                       the true object in convex parts, with its true mass
results/DATASET/OBJECT/grasp_protocol                 its first images in the eight poses, a scene in BOP's layout
results/DATASET/bop/grasping/MODELS/OBJECT/attempts.csv   eight poses, with the usual friction and half of it; failures/ has pictures
results/DATASET/bop/grasp_scenes                      several things on a table, clear and overlapping
results/DATASET/bop/sightings/MODELS                  what the robot makes of them
MODELS: models (true), models_delivered_NVS, models_misjudged_NVS, or true ones damaged on purpose (bop.smk)
"""

GRIPPER, SCENE_COUNTS = (
    step_options({key: settings["simulate"][key] for key in keys} | {"seed": settings["seed"]})
    for keys in (("gripper", "friction"), ("clear_scenes", "overlapping_scenes"))
)


rule physical_model:
    input:
        model=f"{OBJECT}/model",
    output:
        body=f"{OBJECT}/body.npz",
    log:
        f"{OBJECT}/logs/body.log",
    wildcard_constraints:
        dataset=OF_MODELS,
    resources:
        **needs(2000, 10),
    params:
        mass=lambda wildcards: step_options({"mass_kg": settings["assets"]["masses_kg"].get(wildcards.dataset, {}).get(wildcards.object)}),
    message:
        "Splitting the true model of {wildcards.dataset} {wildcards.object} into convex parts"
    shell:
        "python -m zeroshop_steps.simulate --method physical_model --model {input.model}/model.ply"
        " --object {wildcards.dataset}/{wildcards.object} {params.mass} --out {output.body} > {log} 2>&1"


rule protocol_images:
    input:
        model=f"{OBJECT}/model",
        body=f"{OBJECT}/body.npz",
    output:
        images=directory(f"{OBJECT}/grasp_protocol"),
    log:
        f"{OBJECT}/logs/grasp_protocol.log",
    wildcard_constraints:
        dataset=OF_MODELS,
    threads: 2
    resources:
        **needs(3000, 10),
    params:
        seed=settings["seed"],
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
        aligned=plan.alignment,
    output:
        attempts=directory(f"{BOP}/grasping/{{models}}/{{object}}"),
    log:
        f"{BOP}/grasping/{{models}}/logs/{{object}}.log",
    wildcard_constraints:
        dataset=OF_MODELS,
        models=MODELS,
    threads: 2
    resources:
        **needs(3000, 60),
    params:
        inputs=given(),
        options=GRIPPER,
    message:
        "Grasping {wildcards.object} of {wildcards.dataset}, known by its mesh in {wildcards.models}"
    shell:
        "python -m zeroshop_steps.simulate --method attempts {params.inputs} {params.options} --threads {threads} --out {output.attempts}"
        f"{RECORDED_FOLDER}"
        " > {log} 2>&1"


rule grasp_scenes:
    input:
        models=f"{BOP}/models",
    output:
        scenes=directory(f"{BOP}/grasp_scenes"),
    log:
        f"{BOP}/logs/grasp_scenes.log",
    threads: 2
    resources:
        **needs(4000, 20),
    params:
        options=SCENE_COUNTS,
    message:
        "Photographing several things of {wildcards.dataset} on a table"
    shell:
        "python -m zeroshop_steps.simulate --method scenes --models {input.models} {params.options} --threads {threads}"
        " --out {output.scenes} > {log} 2>&1"


rule sightings:
    input:
        scenes=f"{BOP}/grasp_scenes",
        truth=f"{BOP}/models",
        models=f"{BOP}/{{models}}",
        templates=f"{BOP}/templates/{{models}}/42",
        aligned=plan.alignments,
    output:
        sightings=directory(f"{BOP}/sightings/{{models}}"),
    log:
        f"{BOP}/sightings/logs/{{models}}.log",
    wildcard_constraints:
        models=MODELS,
    resources:
        **needs(3000, 30),
    params:
        inputs=given(),
    message:
        "Looking at several things of {wildcards.dataset}, known by their meshes in {wildcards.models}"
    shell:
        "python -m zeroshop_steps.simulate --method sightings {params.inputs} --out {output.sightings}" f"{RECORDED_FOLDER}" " > {log} 2>&1"
