"""Register: cameras and sparse points of a capture, beside its undistorted images and masks.

A registration that fails is a result too: its record says so and why. The steps that would build on it then end with
that reason, while a table goes on with its other cells (matrix.smk).
"""


rule register:
    input:
        capture=capture_of,
    output:
        cameras=directory("results/{dataset}/{object}/{scene}/{registration}/cameras"),
    log:
        "results/{dataset}/{object}/{scene}/{registration}/logs/register.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/benchmarks/register.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=registration_mem_mb,
        runtime=registration_runtime_min,
        gpu=registration_gpus,
    params:
        options=registration_options,
        weights=registration_weights,
    message:
        "Registering the images of {wildcards.object}, scene {wildcards.scene}, with {wildcards.registration}"
    shell:
        "python -m zeroshop_steps.register --method {wildcards.registration} --capture {input.capture}"
        " --scene {wildcards.scene} {params.options} --threads {threads} --keep-going --out {output.cameras} > {log} 2>&1"


rule register_photos:
    input:
        capture=capture_of,
    output:
        scene=directory("results/{dataset}/{object}/{scene}/{registration}/scene"),
    log:
        "results/{dataset}/{object}/{scene}/{registration}/logs/register.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/benchmarks/register.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=registration_mem_mb,
        runtime=registration_runtime_min,
        gpu=registration_gpus,
    params:
        options=registration_options,
        weights=registration_weights,
    message:
        "Registering the photos of {wildcards.object} with {wildcards.registration}"
    shell:
        "python -m zeroshop_steps.register --method {wildcards.registration} --capture {input.capture}"
        " --scene {wildcards.scene} {params.options} --threads {threads} --keep-going --out {output.scene} > {log} 2>&1"


rule camera_error:
    input:
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        capture=capture_of,
    output:
        figures="results/{dataset}/{object}/{scene}/{registration}/camera_error.json",
        table="results/{dataset}/{object}/{scene}/{registration}/camera_error.csv",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/logs/camera_error.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/benchmarks/camera_error.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Comparing the cameras of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, with the true ones"
    shell:
        "python -m zeroshop_steps.evaluate --method camera_error --cameras {input.cameras} --truth {input.capture}/truth"
        " --out {output.figures} > {log} 2>&1"
