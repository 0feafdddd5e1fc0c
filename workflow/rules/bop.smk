"""BOP: a dataset's models, true and reconstructed, in BOP's layout, and scores of what any method found with them.

results/DATASET/bop/models          the true models; models_NVS: the chosen cells of a method, aligned with them
results/DATASET/bop/test            virtual test scenes of the true models, with test_targets_bop19.json and camera.json beside them
results/DATASET/bop/train_SCENE     the rendered captures of all objects in a scene in the layout of a BOP training set
results/DATASET/bop/NAME/poses.csv  estimates of any method; scores.csv beside it is made of them
"""


rule align:
    input:
        mesh=mesh_or_failure_of,
        evidence="results/{dataset}/{object}/{scene}/{registration}/{nvs}/evidence.npz",
        model="results/{dataset}/{object}/model",
    output:
        aligned="results/{dataset}/{object}/{scene}/{registration}/{nvs}/aligned.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/align.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/align.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(10),
    params:
        seed=config["seed"],
    message:
        "Aligning with the true model: {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.bop --method align --mesh {input.mesh} --evidence {input.evidence} --model {input.model}/model.ply --seed {params.seed}"
        " --out {output.aligned} --record-failure {output} > {log} 2>&1"


rule true_models:
    input:
        models=true_models_of,
    output:
        models=directory("results/{dataset}/bop/models"),
    log:
        "results/{dataset}/bop/logs/models.log",
    benchmark:
        "results/{dataset}/bop/benchmarks/models.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(10),
    message:
        "Gathering the true models of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method export_models --parts {input.models} --out {output.models} > {log} 2>&1"


rule reconstructed_models:
    input:
        parts=alignments_of,
        evidence=evidence_of,
    output:
        models=directory("results/{dataset}/bop/models_{nvs}"),
    log:
        "results/{dataset}/bop/logs/models_{nvs}.log",
    benchmark:
        "results/{dataset}/bop/benchmarks/models_{nvs}.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(10),
    message:
        "Gathering the models of {wildcards.dataset} that {wildcards.nvs} made"
    shell:
        "python -m zeroshop_steps.bop --method export_models --parts {input.parts} --out {output.models} > {log} 2>&1"


rule test_set:
    input:
        models="results/{dataset}/bop/models",
        environment=environment_of(config["bop"]["test_set"]),
    output:
        scenes=directory("results/{dataset}/bop/test"),
        targets="results/{dataset}/bop/test_targets_bop19.json",
        camera="results/{dataset}/bop/camera.json",
    log:
        "results/{dataset}/bop/logs/test_set.log",
    benchmark:
        "results/{dataset}/bop/benchmarks/test_set.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(max(60, RENDER_MINUTES[config["bop"]["test_set"]["renderer"]])),
    params:
        options=step_options(config["bop"]["test_set"]),
        environment=environment_option,
        seed=config["seed"],
    message:
        "Rendering the test set of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.synthetic --method make_test_scenes --models {input.models} {params.options} --seed {params.seed}"
        " --threads {threads} {params.environment} --targets {output.targets} --camera {output.camera} --out {output.scenes} > {log} 2>&1"


rule train_set:
    input:
        captures=training_captures_of,
        models=true_models_of,
    output:
        scenes=directory("results/{dataset}/bop/train_{scene}"),
        camera="results/{dataset}/bop/camera_{scene}.json",
    log:
        "results/{dataset}/bop/logs/train_{scene}.log",
    benchmark:
        "results/{dataset}/bop/benchmarks/train_{scene}.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
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
        estimates="results/{dataset}/bop/{estimator}/poses.csv",
        models="results/{dataset}/bop/models",
        scenes="results/{dataset}/bop/test",
        targets="results/{dataset}/bop/test_targets_bop19.json",
    output:
        scores="results/{dataset}/bop/{estimator}/scores.csv",
        errors="results/{dataset}/bop/{estimator}/errors.csv",
    log:
        "results/{dataset}/bop/{estimator}/logs/score_poses.log",
    benchmark:
        "results/{dataset}/bop/{estimator}/benchmarks/score_poses.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(30),
    message:
        "Scoring the poses of {wildcards.estimator} in {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method score_poses --estimates {input.estimates} --targets {input.targets}"
        " --scenes {input.scenes} --models {input.models} --errors-out {output.errors} --out {output.scores} > {log} 2>&1"


rule score_detections:
    input:
        detections="results/{dataset}/bop/{estimator}/detections.json",
        scenes="results/{dataset}/bop/test",
        targets="results/{dataset}/bop/test_targets_bop19.json",
    output:
        scores="results/{dataset}/bop/{estimator}/precision.csv",
    log:
        "results/{dataset}/bop/{estimator}/logs/score_detections.log",
    benchmark:
        "results/{dataset}/bop/{estimator}/benchmarks/score_detections.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(30),
    message:
        "Scoring the masks and boxes of {wildcards.estimator} in {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.bop --method score_detections --detections {input.detections} --targets {input.targets}"
        " --scenes {input.scenes} --of masks boxes --out {output.scores} > {log} 2>&1"
