"""Segment: photos with masks of the object, given or found, without those whose mask is bad.

Scene video is registered as a whole and masked then; video_segmented is masked first and registered by the object alone.
"""


rule capture_object:
    input:
        pictures=pictures_with_masks,
        capture=f"results/{{dataset}}/{{object}}/{WHOLE_SCENE}/capture",
    output:
        capture=directory("results/{dataset}/{object}/{scene}/capture"),
    log:
        "results/{dataset}/{object}/{scene}/logs/capture.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
        scene=OBJECT_SCENE,
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=segmentation_memory_mb,
        runtime=per_attempt(60),
        gpu=segmentation_gpus,
    params:
        options=network_options,
        weights=segmentation_weights,
    message:
        "Taking the pictures of {wildcards.object} with their masks, to register the object alone"
    shell:
        "python -m zeroshop_steps.segment --method object_capture --pictures {input.pictures} --capture {input.capture}"
        " {params.options} --rejected {log}.png --out {output.capture} > {log} 2>&1"


rule segment:
    input:
        scene="results/{dataset}/{object}/{scene}/{registration}/scene",
        capture="results/{dataset}/{object}/{scene}/capture",
    output:
        cameras=directory("results/{dataset}/{object}/{scene}/{registration}/cameras"),
    log:
        "results/{dataset}/{object}/{scene}/{registration}/logs/segment.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/benchmarks/segment.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=segmentation_memory_mb,
        runtime=per_attempt(60),
        gpu=segmentation_gpus,
    params:
        method=segmentation_method,
        options=segmentation_options,
        weights=segmentation_weights,
    message:
        "Masking {wildcards.object} in its photos ({params.method})"
    shell:
        "python -m zeroshop_steps.segment --method {params.method} --scene {input.scene} {params.options}"
        " --rejected {log}.png --keep-going --out {output.cameras} > {log} 2>&1"
