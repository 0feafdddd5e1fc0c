"""Judge a finished mesh: what of it was measured, how far it lies from the truth where there is one, and its grade."""


rule evidence:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/unwrapped.ply",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        stereo="results/{dataset}/{object}/{scene}/{registration}/stereo/seeds.npz",
    output:
        evidence="results/{dataset}/{object}/{scene}/{registration}/{nvs}/evidence.npz",
        figures="results/{dataset}/{object}/{scene}/{registration}/{nvs}/evidence.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/evidence.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/evidence.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Telling what of the mesh was measured: {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.evaluate --method surface_support --mesh {input.mesh} --cameras {input.cameras} --stereo {input.stereo}"
        " --out {output.evidence} --record-failure {output} > {log} 2>&1"


rule quality:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh.ply",
        capture="results/{dataset}/{object}/{scene}/capture",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        model="results/{dataset}/{object}/model",
    output:
        figures="results/{dataset}/{object}/{scene}/{registration}/{nvs}/quality.json",
        table="results/{dataset}/{object}/{scene}/{registration}/{nvs}/quality.csv",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/quality.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/quality.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Measuring against the truth: {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.evaluate --method quality --mesh {input.mesh} --capture {input.capture} --cameras {input.cameras}"
        " --model {input.model}/model.ply --out {output.figures}"
        " --record-failure {output} > {log} 2>&1"


rule grade:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh.ply",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        evidence="results/{dataset}/{object}/{scene}/{registration}/{nvs}/evidence.npz",
        quality=quality_of,
    output:
        grade="results/{dataset}/{object}/{scene}/{registration}/{nvs}/grade.json",
        table="results/{dataset}/{object}/{scene}/{registration}/{nvs}/grade.csv",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/grade.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/grade.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        options=step_options(config["finish"]["grade"]),
        quality=quality_option,
    message:
        "Grading {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.evaluate --method grade --mesh {input.mesh} --cameras {input.cameras} --evidence {input.evidence}"
        " {params.quality} {params.options} --out {output.grade}"
        " --record-failure {output} > {log} 2>&1"
