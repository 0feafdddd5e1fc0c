"""Report: the tidy tables of a dataset, one row a measurement, with the coordinates of its cell; and the gallery, which opens in a browser."""


localrules:
    camera_table,
    reconstruction_table,
    reconstruction_marks,
    bop_table,
    report_index,


rule camera_table:
    input:
        measurements=registrations_in(cells_of_table, "camera_error.csv"),
    output:
        table=report(
            "results/{dataset}/tables/cameras.csv",
            caption="../report/cameras.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "camera errors"},
        ),
    log:
        "results/{dataset}/tables/logs/cameras.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/cameras.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Gathering the camera errors of every registration of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.measurements} --out {output.table} > {log} 2>&1"


rule reconstruction_table:
    input:
        cells=figures_of(cells_of_table),
    output:
        table=report(
            "results/{dataset}/tables/reconstruction.csv",
            caption="../report/reconstruction.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "figures"},
        ),
    log:
        "results/{dataset}/tables/logs/reconstruction.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/reconstruction.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Gathering the grade and the quality of every cell of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.cells} --out {output.table} > {log} 2>&1"


rule reconstruction_marks:
    input:
        table="results/{dataset}/tables/reconstruction.csv",
    output:
        page=report(
            "results/{dataset}/tables/reconstruction.md",
            caption="../report/marks.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "grades"},
        ),
    log:
        "results/{dataset}/tables/logs/reconstruction_marks.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/reconstruction_marks.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
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
        page=report(
            "results/{dataset}/tables/bop.md",
            caption="../report/bop.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "detection and poses"},
        ),
    log:
        "results/{dataset}/tables/logs/bop.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/bop.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    params:
        published=published_option,
    message:
        "Gathering the detections' and poses' scores of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method bop --scores {input.scores} {params.published} --page {output.page}"
        " --out {output.table} > {log} 2>&1"


rule report_object:
    input:
        cells=parts_of_page,
    output:
        page=directory("results/{dataset}/report/objects/{object}"),
    log:
        "results/{dataset}/report/logs/{object}.log",
    benchmark:
        "results/{dataset}/report/benchmarks/{object}.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        folder=shown_object,
        chosen=chosen_run,
        options=step_options(config["report"]["page"]),
        changes=changes_option(),
        others=other_cells,
    message:
        "Writing the report's page of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.report --method object_page --object {params.folder} --chosen {params.chosen}"
        " {params.options} {params.changes} --out {output.page} > {log} 2>&1"


rule report_index:
    input:
        pages=pages_of_report,
    output:
        index="results/{dataset}/report/index.html",
        tables="results/{dataset}/report/tables.html",
        assets=directory("results/{dataset}/report/assets"),
        downloads=directory("results/{dataset}/report/downloads"),
    log:
        "results/{dataset}/report/logs/report_index.log",
    benchmark:
        "results/{dataset}/report/benchmarks/report_index.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        tables="results/{dataset}/tables",
        measured=tables_there,
    message:
        "Writing the report of {wildcards.dataset}: open {output.index} in a browser"
    shell:
        "python -m zeroshop_steps.report --method gallery --dataset {wildcards.dataset} --pages {input.pages}"
        " --tables {params.tables} --out {output.index} > {log} 2>&1"
