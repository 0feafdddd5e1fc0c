"""The thesis: its tables, figure by figure, each beside ours.

results/ycbv/report/thesis/index.html   the page, which `snakemake thesis` makes; thesis.csv beside it has a row per published figure
"""

THESIS = f"{REPORT}/thesis".format(dataset="ycbv")


def figures_of_thesis(
    wildcards,
):
    """All of YCB-V that the thesis has tables of and that can be made here, if the config asks for it; otherwise what is there is shown."""
    if config["thesis"]["make"] == "present":
        return []
    cells = [f"{CELL}/cell.csv".format(**cell) for cell in cells_of("ycbv", objects_of("ycbv"))]
    return [*cells, *(f"{TABLES}/{name}.csv".format(dataset="ycbv") for name in ("height", "bop"))]


def results_of_thesis(
    wildcards,
):
    """Folders with results of YCB-V: those of this config, and others beside or below them."""
    own = Path(REPORT.format(dataset="ycbv")).parents[1]
    roots = dict.fromkeys([own, Path("results"), *sorted(Path("results").glob("*"))])
    return [str(root) for root in roots if (root / "ycbv").is_dir()]


def thesis_there(
    wildcards,
):
    """Results of YCB-V with their times: a parameter, so that the page is made again when these change."""
    places = ("obj_*/*/*/*/outcome.json", "obj_*/*/*/*/grade.json", "tables/*.csv")
    found = [path for root in results_of_thesis(wildcards) for place in places for path in (Path(root) / "ycbv").glob(place)]
    return [f"{path} {path.stat().st_mtime_ns}" for path in sorted(found)]


localrules:
    thesis,


rule thesis:
    input:
        figures=figures_of_thesis,
    output:
        page=f"{THESIS}/index.html",
        table=f"{THESIS}/thesis.csv",
    log:
        f"{THESIS}/logs/thesis.log",
    benchmark:
        f"{THESIS}/benchmarks/thesis.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        results=results_of_thesis,
        recorded=os.path.relpath(ROOT / "docs"),
        there=thesis_there,
    message:
        "Putting the thesis's figures beside ours: open {output.page} in a browser"
    shell:
        "python -m zeroshop_steps.report --method thesis --results {params.results} --recorded {params.recorded:q}"
        " --table {output.table} --out {output.page} > {log} 2>&1"
