"""Height: how many metres the object is high, and a unit of its registration long; how well that is known."""


rule height:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/clean.ply",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        capture="results/{dataset}/{object}/{scene}/capture",
    output:
        height="results/{dataset}/{object}/{scene}/{registration}/{nvs}/height.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/height.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/height.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=10,
    params:
        method=height_method,
    message:
        "Measuring the height of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.height --method {params.method} --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --out {output.height}"
        " --record-failure {output} > {log} 2>&1"
