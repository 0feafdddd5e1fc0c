"""Report: what a dataset's results look like, in any browser.

results/DATASET/report/index.html        the gallery and the tables
results/DATASET/report/objects/OBJECT    the page of an object
results/ycbv/report/thesis/index.html    the thesis's tables, figure by figure, each beside ours, which `snakemake thesis` makes; thesis.csv
                                         beside it has a row per published figure, other_kinds.csv one per figure of ours that is none
"""

THESIS = f"{REPORT}/thesis".format(dataset="ycbv")
RECORDED_FIGURES = "--rehearsal" if settings["thesis"]["rehearsal"] else f"--recorded {shlex.quote(os.path.relpath(PROJECT / 'docs'))}"


localrules:
    report_index,
    thesis,


rule report_object:
    input:
        cells=plan.parts_of_page,
    output:
        page=directory(f"{REPORT}/objects/{{object}}"),
    log:
        f"{REPORT}/logs/{{object}}.log",
    resources:
        **needs(3000, 10),
    params:
        folder=OBJECT,
        chosen=plan.first_shown,
        options=step_options(settings["report"].get("page", {})),
        changes=lambda wildcards: plan.changes_option(PROJECT / "config/config.yaml"),
        others=plan.other_cells,
    message:
        "Writing the report's page of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.report --method object_page --object {params.folder} --chosen {params.chosen}"
        " {params.options} {params.changes} --out {output.page} > {log} 2>&1"


rule report_index:
    input:
        pages=plan.pages,
    output:
        index=f"{REPORT}/index.html",
        tables=f"{REPORT}/tables.html",
        assets=directory(f"{REPORT}/assets"),
        downloads=directory(f"{REPORT}/downloads"),
    log:
        f"{REPORT}/logs/report_index.log",
    resources:
        **needs(1000, 5),
    params:
        tables=TABLES,
        measured=plan.tables_there,
    message:
        "Writing the report of {wildcards.dataset}: open {output.index} in a browser"
    shell:
        "python -m zeroshop_steps.report --method gallery --dataset {wildcards.dataset} --pages {input.pages}"
        " --tables {params.tables} --out {output.index} > {log} 2>&1"


rule thesis:
    input:
        figures=plan.figures_of_thesis,
    output:
        page=f"{THESIS}/index.html",
        table=f"{THESIS}/thesis.csv",
        others=f"{THESIS}/other_kinds.csv",
    log:
        f"{THESIS}/logs/thesis.log",
    resources:
        **needs(1000, 5),
    params:
        results=plan.results_of_thesis,
        recorded=RECORDED_FIGURES,
        there=plan.thesis_there,
    message:
        "Putting the thesis's figures beside ours: open {output.page} in a browser"
    shell:
        "python -m zeroshop_steps.report --method thesis --results {params.results} {params.recorded}"
        " --table {output.table} --other-table {output.others} --out {output.page} > {log} 2>&1"
