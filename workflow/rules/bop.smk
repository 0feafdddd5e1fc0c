"""BOP: a dataset's models, true and reconstructed, in BOP's layout, and scores of what any method found with them.

results/DATASET/bop/models          the true models; models_NVS: the chosen cells of a method, aligned with them
results/DATASET/bop/models_delivered_NVS   these meshes as they were made, in their own frames and scales
results/DATASET/bop/models_misjudged_NVS   the same, each as much too large or small as the height that the thesis published of it
results/DATASET/bop/models_scaled_plus_5, models_without_underside   true models, damaged on purpose
results/DATASET/bop/test            virtual test scenes of the true models, or BOP's own where the dataset names its test_folder; beside
                                    them test_targets_bop19.json and camera.json
results/DATASET/bop/train_SCENE     the rendered captures of all objects in a scene in the layout of a BOP training set
results/DATASET/bop/NAME/poses.csv  estimates of any method; scores.csv beside it is made of them
"""

from zeroshop_steps.plan.tables import DAMAGES

WITH_REAL_TESTS = "|".join(filter(plan.has_real_tests, settings["datasets"])) or NOTHING
TEST_SET = {"scenes": directory(f"{BOP}/test"), "targets": f"{BOP}/test_targets_bop19.json", "camera": f"{BOP}/camera.json"}


rule align:
    input:
        mesh=f"{CELL}/mesh.ply",
        evidence=f"{CELL}/evidence.npz",
        model=f"{OBJECT}/model",
    output:
        aligned=f"{CELL}/aligned.json",
    log:
        f"{CELL}/logs/align.log",
    wildcard_constraints:
        dataset=OF_MODELS,
    resources:
        **needs(2000, 10),
    params:
        seed=settings["seed"],
    message:
        "Aligning with the true model: {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.bop --method align --mesh {input.mesh} --evidence {input.evidence} --model {input.model}/model.ply"
        " --seed {params.seed} --out {output.aligned} --record-failure {output} > {log} 2>&1"


ALIGNED = {"parts": plan.in_chosen_cells("aligned.json"), "evidence": plan.in_chosen_cells("evidence.npz")}
OTHER_MODELS = r"(?!scaled_|without_|delivered_|misjudged_)[^/.]+"
# By rule: the folder, the methods, what it reads, an option and what it says.
COLLECTED = {
    "true_models": ("models", "[^/.]+", {"parts": plan.true_models}, "", "Gathering the true models of {wildcards.dataset}"),
    "reconstructed_models": (
        "models_{nvs}",
        OTHER_MODELS,
        ALIGNED,
        "",
        "Gathering the models of {wildcards.dataset} that {wildcards.nvs} made",
    ),
    "delivered_models": (
        "models_delivered_{nvs}",
        OTHER_MODELS,
        ALIGNED,
        "--own-frames",
        "Gathering the models of {wildcards.dataset} that {wildcards.nvs} made, as a robot gets them",
    ),
}
for name, (folder, surfaces, reads, frames, says) in COLLECTED.items():

    rule:
        name:
            name
        input:
            **reads,
        output:
            models=directory(f"{BOP}/{folder}"),
        log:
            f"{BOP}/logs/{folder}.log",
        wildcard_constraints:
            nvs=surfaces,
        resources:
            **needs(2000, 10),
        params:
            frames=frames,
        message:
            says
        shell:
            "python -m zeroshop_steps.bop --method export_models --parts {input.parts} {params.frames} --out {output.models}"
            f"{RECORDED_FOLDER}"
            " > {log} 2>&1"


# By rule: the folder of the whole models, that of the damaged ones, an option and what it says.
DAMAGED = {
    "damaged_models": (
        "models",
        "models_{damage}",
        lambda wildcards: DAMAGES[wildcards.damage],
        "Damaging the true models of {wildcards.dataset}: {wildcards.damage}",
    ),
    "misjudged_models": (
        "models_delivered_{nvs}",
        "models_misjudged_{nvs}",
        plan.height_errors,
        "Giving the models of {wildcards.dataset} that {wildcards.nvs} made the errors of the thesis's heights",
    ),
}
for name, (whole, damaged, damage, says) in DAMAGED.items():

    rule:
        name:
            name
        input:
            models=f"{BOP}/{whole}",
        output:
            models=directory(f"{BOP}/{damaged}"),
        log:
            f"{BOP}/logs/{damaged}.log",
        wildcard_constraints:
            damage="|".join(DAMAGES),
        resources:
            **needs(2000, 20),
        params:
            damage=damage,
        message:
            says
        shell:
            "python -m zeroshop_steps.bop --method damage_models --models {input.models} {params.damage} --out {output.models}"
            f"{RECORDED_FOLDER}"
            " > {log} 2>&1"


rule test_set:
    input:
        models=f"{BOP}/models",
        environment=TEST_RENDERER.environment or [],
    output:
        **TEST_SET,
    log:
        f"{BOP}/logs/test_set.log",
    wildcard_constraints:
        dataset=rf"(?!(?:{WITH_REAL_TESTS})/)[^/]+",
    threads: 8
    resources:
        **needs(4000, max(60, TEST_RENDERER.runtime_min)),
    params:
        options=step_options({**settings["bop"]["test_set"], "seed": settings["seed"]}),
        environment=given("environment"),
    message:
        "Rendering the test set of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.synthetic --method make_test_scenes --models {input.models} {params.options}"
        " --threads {threads} {params.environment} --targets {output.targets} --camera {output.camera} --out {output.scenes} > {log} 2>&1"


rule real_test_set:
    input:
        models=f"{BOP}/models",
    output:
        **TEST_SET,
    log:
        f"{BOP}/logs/test_set.log",
    wildcard_constraints:
        dataset=WITH_REAL_TESTS,
    resources:
        **needs(4000, 120),
    params:
        test=plan.test_option,
    message:
        "Taking BOP's own test images of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method take_test_set --dataset {wildcards.dataset} {params.test} --models {input.models}"
        " --targets {output.targets} --camera {output.camera} --out {output.scenes} > {log} 2>&1"


rule train_set:
    input:
        captures=plan.training_captures,
        models=plan.true_models,
    output:
        scenes=directory(f"{BOP}/train_{{scene}}"),
        camera=f"{BOP}/camera_{{scene}}.json",
    log:
        f"{BOP}/logs/train_{{scene}}.log",
    wildcard_constraints:
        dataset=OF_MODELS,
    resources:
        **needs(2000, 60),
    message:
        "Gathering the captures of {wildcards.dataset} in scene {wildcards.scene} as a training set"
    shell:
        "python -m zeroshop_steps.synthetic --method make_train_scenes --captures {input.captures} --models {input.models}"
        " --camera {output.camera} --out {output.scenes} > {log} 2>&1"


rule score_poses:
    input:
        estimates=f"{BOP}/{{estimator}}/poses.csv",
        models=f"{BOP}/models",
        scenes=f"{BOP}/test",
        targets=f"{BOP}/test_targets_bop19.json",
        camera=f"{BOP}/camera.json",
    output:
        scores=f"{BOP}/{{estimator}}/scores.csv",
        errors=f"{BOP}/{{estimator}}/errors.csv",
    log:
        f"{BOP}/{{estimator}}/logs/score_poses.log",
    threads: 2
    resources:
        **needs(2000, 30),
    params:
        inputs=given(),
    message:
        "Scoring the poses of {wildcards.estimator} in {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method score_poses {params.inputs} --errors-out {output.errors} --out {output.scores}"
        f"{RECORDED}"
        " > {log} 2>&1"


rule score_detections:
    input:
        detections=f"{BOP}/{{estimator}}/detections.json",
        scenes=f"{BOP}/test",
        targets=f"{BOP}/test_targets_bop19.json",
    output:
        scores=f"{BOP}/{{estimator}}/precision.csv",
    log:
        f"{BOP}/{{estimator}}/logs/score_detections.log",
    resources:
        **needs(2000, 30),
    params:
        inputs=given(),
    message:
        "Scoring the masks and boxes of {wildcards.estimator} in {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method score_detections {params.inputs} --of masks boxes --out {output.scores}"
        f"{RECORDED}"
        " > {log} 2>&1"
