"""BOP: a dataset's models, true and reconstructed, in BOP's layout, and scores of what any method found with them.

results/DATASET/bop/models          the true models; models_NVS: the chosen cells of a method, aligned with them
results/DATASET/bop/test            virtual test scenes of the true models, or BOP's own where the dataset names its test_folder; beside
                                    them test_targets_bop19.json and camera.json
results/DATASET/bop/train_SCENE     the rendered captures of all objects in a scene in the layout of a BOP training set
results/DATASET/bop/NAME/poses.csv  estimates of any method; scores.csv beside it is made of them
"""


def true_models_of(
    wildcards,
):
    """The true models of a dataset's objects."""
    virtual_dataset(wildcards.dataset, "Photos have no true models.")
    return [f"{RESULTS}/{wildcards.dataset}/{name}/model" for name in objects_of(wildcards.dataset)]


def training_captures_of(
    wildcards,
):
    """The captures of a dataset's objects in a scene."""
    check_virtual_scene(wildcards)
    return [f"{Path(model).parent}/{wildcards.scene}/capture" for model in true_models_of(wildcards)]


def in_chosen_cells(
    name,
):
    """An input function: this file of the chosen cell of each object of a dataset."""

    def files(
        wildcards,
    ):
        usable("nvs method", wildcards.nvs, SURFACES, "The folder is named after the method.")
        chosen = config["chosen"]["virtual"]
        cells = cells_of(wildcards.dataset, objects_of(wildcards.dataset), [chosen["scene"]], [chosen["registration"]], [wildcards.nvs])
        return [f"{CELL}/{name}".format(**cell) for cell in cells]

    return files


def has_real_tests(
    dataset,
):
    """Whether a dataset is tested on BOP's own images."""
    return bool(config["datasets"][dataset].get("test_folder"))


def test_folder_option(
    wildcards,
):
    """The option that names a local folder of test scenes; none where they are downloaded."""
    place = config["datasets"][wildcards.dataset]["test_folder"]
    return "" if place == "download" else f"--test {shlex.quote(os.path.relpath(ROOT / place))}"


# Datasets with test images of their own, as a wildcard constraint.
WITH_REAL_TESTS = "|".join(filter(has_real_tests, config["datasets"])) or "(?!)"


rule align:
    input:
        mesh=f"{CELL}/mesh.ply",
        evidence=f"{CELL}/evidence.npz",
        model=f"{OBJECT}/model",
    output:
        aligned=f"{CELL}/aligned.json",
    log:
        f"{CELL}/logs/align.log",
    benchmark:
        f"{CELL}/benchmarks/align.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(10),
    params:
        seed=config["seed"],
    message:
        "Aligning with the true model: {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.bop --method align --mesh {input.mesh} --evidence {input.evidence} --model {input.model}/model.ply"
        " --seed {params.seed} --out {output.aligned} --record-failure {output} > {log} 2>&1"


rule true_models:
    input:
        parts=true_models_of,
    output:
        models=directory(f"{BOP}/models"),
    log:
        f"{BOP}/logs/models.log",
    benchmark:
        f"{BOP}/benchmarks/models.tsv"
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(10),
    params:
        frames="",
    message:
        "Gathering the true models of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method export_models --parts {input.parts} {params.frames} --out {output.models}"
        f"{RECORDED_FOLDER}"
        " > {log} 2>&1"


use rule true_models as reconstructed_models with:
    input:
        parts=in_chosen_cells("aligned.json"),
        evidence=in_chosen_cells("evidence.npz"),
    output:
        models=directory(f"{BOP}/models_{{nvs}}"),
    log:
        f"{BOP}/logs/models_{{nvs}}.log",
    benchmark:
        f"{BOP}/benchmarks/models_{{nvs}}.tsv"
    wildcard_constraints:
        nvs=r"(?!scaled_|without_|delivered_|misjudged_)[^/.]+",  # other folders of models (robustness.smk, simulate.smk)
    message:
        "Gathering the models of {wildcards.dataset} that {wildcards.nvs} made"


rule test_set:
    input:
        models=f"{BOP}/models",
        environment=environment_of(config["bop"]["test_set"]),
    output:
        scenes=directory(f"{BOP}/test"),
        targets=f"{BOP}/test_targets_bop19.json",
        camera=f"{BOP}/camera.json",
    log:
        f"{BOP}/logs/test_set.log",
    benchmark:
        f"{BOP}/benchmarks/test_set.tsv"
    wildcard_constraints:
        dataset=rf"(?!(?:{WITH_REAL_TESTS})/)[^/]+",
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(max(60, renderer_of(config["bop"]["test_set"]).runtime_min)),
    params:
        options=step_options(config["bop"]["test_set"]),
        environment=environment_option,
        seed=config["seed"],
    message:
        "Rendering the test set of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.synthetic --method make_test_scenes --models {input.models} {params.options} --seed {params.seed}"
        " --threads {threads} {params.environment} --targets {output.targets} --camera {output.camera} --out {output.scenes} > {log} 2>&1"


rule real_test_set:
    input:
        models=f"{BOP}/models",
    output:
        scenes=directory(f"{BOP}/test"),
        targets=f"{BOP}/test_targets_bop19.json",
        camera=f"{BOP}/camera.json",
    log:
        f"{BOP}/logs/test_set.log",
    benchmark:
        f"{BOP}/benchmarks/test_set.tsv"
    wildcard_constraints:
        dataset=WITH_REAL_TESTS,
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(120),
    params:
        test=test_folder_option,
    message:
        "Taking BOP's own test images of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method take_test_set --dataset {wildcards.dataset} {params.test} --models {input.models}"
        " --targets {output.targets} --camera {output.camera} --out {output.scenes} > {log} 2>&1"


rule train_set:
    input:
        captures=training_captures_of,
        models=true_models_of,
    output:
        scenes=directory(f"{BOP}/train_{{scene}}"),
        camera=f"{BOP}/camera_{{scene}}.json",
    log:
        f"{BOP}/logs/train_{{scene}}.log",
    benchmark:
        f"{BOP}/benchmarks/train_{{scene}}.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(60),
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
    benchmark:
        f"{BOP}/{{estimator}}/benchmarks/score_poses.tsv"
    threads: 2
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(30),
    message:
        "Scoring the poses of {wildcards.estimator} in {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method score_poses --estimates {input.estimates} --targets {input.targets}"
        " --scenes {input.scenes} --models {input.models} --camera {input.camera} --errors-out {output.errors} --out {output.scores}"
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
    benchmark:
        f"{BOP}/{{estimator}}/benchmarks/score_detections.tsv"
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(30),
    message:
        "Scoring the masks and boxes of {wildcards.estimator} in {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method score_detections --detections {input.detections} --targets {input.targets}"
        " --scenes {input.scenes} --of masks boxes --out {output.scores}"
        f"{RECORDED}"
        " > {log} 2>&1"
