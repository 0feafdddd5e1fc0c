"""The thesis: its tables, figure by figure, each beside ours.

results/ycbv/report/thesis/index.html   the page, which `snakemake thesis` makes; thesis.csv beside it has a row per published
                                        figure, other_kinds.csv one per figure of ours that is none of these
"""

from zeroshop_steps.report.published import thesis_plan

THESIS = f"{REPORT}/thesis".format(dataset="ycbv")


@functools.cache
def say_what_the_thesis_takes(
    dataset,
):
    """Hours and GB of what was published, and which weights and films are not there: once, before anything runs."""
    objects = objects_of(dataset)
    of_models = [{"object": name, "nvs": nvs, **config["chosen"]["virtual"]} for name in objects for nvs in table_axis("nvs")]
    cells = {tuple(sorted(cell.items())): cell for cell in (*thesis_plan.list_marks(objects), *of_models)}
    named = [methods.REGISTRATIONS[name] for name in {cell["registration"] for cell in cells.values()}]
    named += [*map(SURFACES.get, table_axis("nvs")), *map(DETECTORS.get, table_axis("detectors"))]
    named += [*map(ESTIMATORS.get, table_axis("estimators")), HEIGHTS["mast3r"]]
    missing = sorted({file for method in named for file in method.files if not (methods.WEIGHTS_FOLDER / file).is_file()})
    known = weights_table()
    mb = sum((known[file].size_bytes or 0) / 1e6 for file in missing if file in known)
    logger.info(thesis_plan.say_costs(cells.values(), mb, has_real_tests(dataset)))
    if missing:
        logger.info(f"Cells of these become failed ones unless `snakemake weights` fetches them before: {', '.join(missing)}")
    films = filmed_objects(objects_of("photos"))
    absent = [name for name in objects_of("photos") if name not in films]
    if absent:
        logger.info(f"Left out, as {config['objects_table']} names films or photos that are not there: {', '.join(absent)}")


def figures_of_thesis(
    wildcards,
):
    """What the thesis published of YCB-V and of its films, if the config asks for it; otherwise what is there is shown."""
    if config["thesis"]["make"] == "present":
        return []
    say_what_the_thesis_takes("ycbv")
    objects = objects_of("ycbv")
    # The cells of the models of Table 4.5 are graded, too: what differs in them differs in its scores.
    of_models = [{"object": name, "nvs": nvs, **thesis_plan.OF_MODELS} for name in objects for nvs in surfaces_with_cameras("Table 4.5")]
    cells = [f"{CELL}/cell.csv".format(dataset="ycbv", **cell) for cell in [*thesis_plan.list_marks(objects), *of_models]]
    cells = list(dict.fromkeys(cells))
    films = filmed_objects(objects_of("photos"))
    place = {"dataset": "photos", "scene": WHOLE_SCENE, "registration": config["chosen"]["photos"]["registration"]}
    cells += [f"{CELL}/cell.csv".format(**place, object=name, nvs=nvs) for name in films for nvs in measured_surfaces("the table of films")]
    heights = [f"{TABLES}/height.csv".format(dataset="photos")] if films else []
    return [*cells, *heights, *(f"{TABLES}/{name}.csv".format(dataset="ycbv") for name in ("bop", "grasp"))]


def results_of_thesis(
    wildcards,
):
    """Folders with results of YCB-V or of films: those of this config, and others beside or below them."""
    own = Path(REPORT.format(dataset="ycbv")).parents[1]
    roots = dict.fromkeys([own, Path("results"), *sorted(Path("results").glob("*"))])
    return [str(root) for root in roots if (root / "ycbv").is_dir() or (root / "photos").is_dir()]


def thesis_there(
    wildcards,
):
    """Results of YCB-V with their times: a parameter, so that the page is made again when these change."""
    places = [f"{name}/{place}" for name in ("ycbv", "photos") for place in ("*/*/*/*/outcome.json", "*/*/*/*/grade.json", "tables/*.csv")]
    found = [path for root in results_of_thesis(wildcards) for place in places for path in Path(root).glob(place)]
    return [f"{path} {path.stat().st_mtime_ns}" for path in sorted(found)]


localrules:
    thesis,


rule thesis:
    input:
        figures=figures_of_thesis,
    output:
        page=f"{THESIS}/index.html",
        table=f"{THESIS}/thesis.csv",
        others=f"{THESIS}/other_kinds.csv",
    log:
        f"{THESIS}/logs/thesis.log",
    benchmark:
        f"{THESIS}/benchmarks/thesis.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        results=results_of_thesis,
        recorded="--rehearsal" if config["thesis"]["rehearsal"] else f"--recorded {shlex.quote(os.path.relpath(PROJECT / 'docs'))}",
        there=thesis_there,
    message:
        "Putting the thesis's figures beside ours: open {output.page} in a browser"
    shell:
        "python -m zeroshop_steps.report --method thesis --results {params.results} {params.recorded}"
        " --table {output.table} --other-table {output.others} --out {output.page} > {log} 2>&1"
