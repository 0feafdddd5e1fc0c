"""Report: the tidy tables of a dataset, one row a measurement, with the coordinates of its cell."""


localrules:
    camera_table,
    reconstruction_table,
    reconstruction_marks,
    bop_table,


rule camera_table:
    input:
        measurements=registrations_in(cells_of_table, "camera_error.csv"),
    output:
        table="results/{dataset}/tables/cameras.csv",
    log:
        "results/{dataset}/tables/logs/cameras.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/cameras.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    message:
        "Gathering the camera errors of every registration of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.measurements} --out {output.table} > {log} 2>&1"


rule reconstruction_table:
    input:
        cells=figures_of(cells_of_table),
    output:
        table="results/{dataset}/tables/reconstruction.csv",
    log:
        "results/{dataset}/tables/logs/reconstruction.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/reconstruction.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    message:
        "Gathering the grade and the quality of every cell of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.cells} --out {output.table} > {log} 2>&1"


rule reconstruction_marks:
    input:
        table="results/{dataset}/tables/reconstruction.csv",
    output:
        page="results/{dataset}/tables/reconstruction.md",
    log:
        "results/{dataset}/tables/logs/reconstruction_marks.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/reconstruction_marks.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        published=published_option,
    message:
        "Marking every cell of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method reconstruction --table {input.table} {params.published} --out {output.page} > {log} 2>&1"


rule bop_table:
    input:
        scores=scores_of_table,
    output:
        table="results/{dataset}/tables/bop.csv",
        page="results/{dataset}/tables/bop.md",
    log:
        "results/{dataset}/tables/logs/bop.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/bop.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        published=published_option,
    message:
        "Gathering the detections' and poses' scores of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method bop --scores {input.scores} {params.published} --page {output.page}"
        " --out {output.table} > {log} 2>&1"
