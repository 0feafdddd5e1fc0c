"""Segment: the registered photos with masks of the object, given or found, without those whose mask is bad."""


rule segment:
    input:
        scene="results/{dataset}/{object}/{scene}/{registration}/scene",
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
        mem_mb=4000,
        runtime=20,
    params:
        method=segmentation_method,
        options=segmentation_options,
    message:
        "Masking {wildcards.object} in its photos ({params.method})"
    shell:
        "python -m zeroshop_steps.segment --method {params.method} --scene {input.scene} {params.options}"
        " --keep-going --out {output.cameras} > {log} 2>&1"
