"""The matrix: how every cell ended, and the slices of it that a user asks for.

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/cell.csv   one cell: its grade and figures, or grade none and the reason
results/DATASET/OBJECT/cells.csv                         one object: every cell of it
results/DATASET/tables/SCENE/REGISTRATION/NVS.csv        one column: this cell of every object
results/DATASET/tables/reconstruction.csv                one table: every cell of every object
results/DATASET/tables/reconstruction.md                 its grades as marks (report.smk)

A failed cell is a result: in such a run a step that fails leaves a record, `outcome` ends in it, and the others go on.
"""


# On a cluster, what takes a second is done where Snakemake runs.
localrules:
    outcome,
    cell,
    object_table,
    column_table,


checkpoint outcome:
    input:
        parts=parts_of_mesh,
    output:
        outcome="results/{dataset}/{object}/{scene}/{registration}/{nvs}/outcome.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/outcome.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/outcome.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Noting how {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}, ended"
    shell:
        "python -m zeroshop_steps.evaluate --method outcome --parts {input.parts} --out {output.outcome}"
        " --record-failure {output} > {log} 2>&1"


rule cell:
    input:
        measurements=measurements_of,
    output:
        table="results/{dataset}/{object}/{scene}/{registration}/{nvs}/cell.csv",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/cell.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/cell.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Gathering the figures of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.measurements} --out {output.table} > {log} 2>&1"


rule object_table:
    input:
        cells=figures_of(cells_of_object),
    output:
        table="results/{dataset}/{object}/cells.csv",
    log:
        "results/{dataset}/{object}/logs/cells.log",
    benchmark:
        "results/{dataset}/{object}/benchmarks/cells.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Gathering every cell of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.cells} --out {output.table} > {log} 2>&1"


rule column_table:
    input:
        cells=figures_of(cells_of_column),
    output:
        table="results/{dataset}/tables/{scene}/{registration}/{nvs}.csv",
    log:
        "results/{dataset}/tables/logs/{scene}.{registration}.{nvs}.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/{scene}.{registration}.{nvs}.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Gathering scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs} of every object of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.cells} --out {output.table} > {log} 2>&1"
