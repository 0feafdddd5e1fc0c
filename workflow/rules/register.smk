"""Register: cameras and sparse points of a capture, beside its undistorted images and masks."""


rule register:
    input:
        capture=capture_of,
    output:
        cameras=directory("results/{dataset}/{object}/{scene}/{registration}/cameras"),
    log:
        "results/{dataset}/{object}/{scene}/{registration}/logs/register.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/benchmarks/register.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        options=registration_options,
    message:
        "Registering the images of {wildcards.object}, scene {wildcards.scene}, with {wildcards.registration}"
    shell:
        "python -m zeroshop_steps.register --method {wildcards.registration} --capture {input.capture}"
        " --scene {wildcards.scene} {params.options} --threads {threads} --out {output.cameras} > {log} 2>&1"
