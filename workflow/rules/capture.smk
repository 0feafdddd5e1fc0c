"""Capture: a model and rendered views of it for virtual datasets, checked copies of the user's photos for the others."""


rule demo_model:
    output:
        model=directory("results/{dataset}/{object}/model"),
    log:
        "results/{dataset}/{object}/logs/model.log",
    benchmark:
        "results/{dataset}/{object}/benchmarks/model.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(5),
    params:
        object=checked_object,
    message:
        "Making the demo object {wildcards.object}"
    shell:
        "python -m zeroshop_steps.synthetic --method demo_objects --object {params.object} --out {output.model} > {log} 2>&1"


rule bop_model:
    output:
        model=directory("results/{dataset}/{object}/model"),
    log:
        "results/{dataset}/{object}/logs/model.log",
    benchmark:
        "results/{dataset}/{object}/benchmarks/model.tsv"
    wildcard_constraints:
        dataset=datasets_of("bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(60),
    params:
        object=checked_object,
        models=models_option,
    message:
        "Fetching the model of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.synthetic --method bop_models --dataset {wildcards.dataset} --object {params.object}"
        " {params.models} --out {output.model} > {log} 2>&1"


rule blender_environment:
    input:
        requirements=BLENDER_REQUIREMENTS,
    output:
        record=BLENDER_RECORD,
    log:
        "resources/envs/blenderproc.log",
    benchmark:
        "resources/envs/blenderproc.tsv"
    conda:
        "../envs/blenderproc.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(60),
    message:
        "Setting up BlenderProc in an environment of its own"
    shell:
        "python -m zeroshop_steps.synthetic --method blender_environment --requirements {input.requirements:q}"
        " --folder resources/envs/blenderproc --out {output.record} > {log} 2>&1"


rule capture_virtual:
    input:
        model=rendered_model,
        environment=environment_of(config["capture"]),
    output:
        capture=directory("results/{dataset}/{object}/{scene}/capture"),
    log:
        "results/{dataset}/{object}/{scene}/logs/capture.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
        scene=f"(?!{BOARD_SCENE}/)[^/]+",
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(RENDER_MINUTES[config["capture"]["renderer"]]),
    params:
        width_px=config["capture"]["image_width_px"],
        height_px=config["capture"]["image_height_px"],
        seed=config["seed"],
        method=config["capture"]["renderer"],
        options=capture_renderer_options,
    message:
        "Rendering the views of {wildcards.object} in scene {wildcards.scene}"
    shell:
        "python -m zeroshop_steps.synthetic --method {params.method} --model {input.model}/model.ply --scene {wildcards.scene}"
        " --width {params.width_px} --height {params.height_px} --seed {params.seed} --threads {threads} {params.options} --out {output.capture} > {log} 2>&1"


rule capture_photos:
    input:
        images=photo_files("images"),
        masks=mask_files,
    output:
        capture=directory("results/{dataset}/{object}/{scene}/capture"),
    log:
        "results/{dataset}/{object}/{scene}/logs/capture.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
        scene=WHOLE_SCENE,
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(5),
    params:
        images=photo_place,
        method=capture_method,
        options=capture_options,
    message:
        "Taking the pictures of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.capture --method {params.method} --images {params.images:q} {params.options}"
        " --out {output.capture} > {log} 2>&1"
