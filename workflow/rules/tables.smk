"""Tables: measurements, one a row, and pages made of them. Each is a row of RULES, made by a method of the stage `report`.

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/cell.csv   one cell: its grade and figures, or grade none and the reason
results/DATASET/OBJECT/cells.csv                         one object: every cell of it
results/DATASET/tables/SCENE/REGISTRATION/NVS.csv        one column: this cell of every object
results/DATASET/tables/
    cameras.csv                         how right the cameras are
    reconstruction.csv, .md             grades and figures of every cell; its grades as marks
    height.csv, .svg                    how far a printed board is off (thesis, Tables 4.3 and 4.4, Figure 4.8)
    masks.csv, film_height.csv          of films: masks frame by frame, heights by the printed board
    bop.csv, .md, .json                 detections and poses; the settings that they were made with
    detectors.csv, .md, .json           CNOS and SAM-6D, each with regions by SAM and by FastSAM (thesis, 4.4.1)
    estimators.csv, .md, .json          FoundationPose beside SAM-6D, regions by SAM (thesis, 4.4.2)
    robustness.csv, .svg                AR of poses from true masks with models that are damaged on purpose
    grasp.csv, .md                      the thesis's Table 4.6 in simulation; for YCB-V also with heights as wrong as published
    grasp_scenes.csv                    the scenes of several things alone
    grasp_robustness.csv                attempts with true models that are damaged on purpose
    grasp_scale.svg, _underside.svg     its two plots

A failed cell is a result: a step of a cell that fails leaves a record (`--record-failure`), the steps after it pass it on, and the other
cells go on. The chosen mesh is never a record: asked for, such a cell ends with the reason.
For the table of heights every object is measured twice: with the board beside it in its views (scene su_b), and by photos of the empty
scene with the board, while its views (su_h) show none.
"""


def table(file, says, reads, title="", caption="", category="Tables", **more):
    """A row of RULES.

    `reads` are its inputs by the options that name them. With a title, it is in Snakemake's report. Of what else it writes, `writes` has
    the files by the options that name them, and `beside` those that the step names itself.
    """
    path = Path(file if Path(file).name != file else f"{TABLES}/{file}")
    row = {"path": str(path), "says": says, "reads": reads, "writes": {}, "beside": [], "dataset": "[^/]+", "mb": 500}
    row |= {"method": "table", "options": plan.root_option, "log": f"{path.parent}/logs/{path.stem}.log"} | more
    return row | ({"path": shown(path, title, caption or path.stem, category)} if title else {})


def shown(path, title, caption, category="Tables"):
    """A file of Snakemake's report."""
    return report(str(path), caption=f"../report/{caption}.rst", category=category, subcategory="{dataset}", labels={"table": title})


def scores(name, says, reads, page, options):
    """A row of RULES: a table of scores with its page and settings."""
    return table(
        f"{name}.csv",
        says,
        {"scores": reads},
        method="bop",
        options=options,
        writes={"page": page, "settings_out": f"{TABLES}/{name}.json"},
    )


OF_CELL = "{wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
RULES = {
    "cell": table(f"{CELL}/cell.csv", f"Gathering the figures of {OF_CELL}", {"measurements": plan.measurements}),
    "object_table": table(
        f"{OBJECT}/cells.csv",
        "Gathering every cell of {wildcards.dataset} {wildcards.object}",
        {"measurements": plan.figures_of(plan.cells_of_object)},
    ),
    "column_table": table(
        f"{TABLES}/{{scene}}/{{registration}}/{{nvs}}.csv",
        "Gathering scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs} of every object of {wildcards.dataset}",
        {"measurements": plan.figures_of(plan.cells_of_column)},
        log=f"{TABLES}/logs/{{scene}}.{{registration}}.{{nvs}}.log",
    ),
    "camera_table": table(
        "cameras.csv",
        "Gathering the camera errors of every registration of {wildcards.dataset}",
        {"measurements": plan.camera_errors},
        "camera errors",
        mb=1000,
    ),
    "reconstruction_table": table(
        "reconstruction.csv",
        "Gathering the grade and the quality of every cell of {wildcards.dataset}",
        {"measurements": plan.figures_of(plan.cells_of_table)},
        "figures",
        mb=1000,
    ),
    "reconstruction_marks": table(
        "reconstruction.md",
        "Marking every cell of {wildcards.dataset}",
        {"table": f"{TABLES}/reconstruction.csv"},
        "grades",
        "marks",
        method="reconstruction",
        options=plan.published_option,
        log=f"{TABLES}/logs/reconstruction_marks.log",
    ),
    "mask_table": table(
        "masks.csv",
        "Gathering how right the masks of {wildcards.dataset} are",
        {"measurements": plan.of_films(f"{RUN}/mask_error.csv")},
        dataset=plan.of_kinds("films"),
        mb=1000,
    ),
    "height_table": table(
        "height.csv",
        "Comparing the measured heights of {wildcards.dataset} with the true ones",
        {"heights": plan.measured_heights},
        "heights",
        "heights",
        "Heights",
        method="heights",
        beside=[shown(f"{TABLES}/height.svg", "Figure 4.8", "heights", "Heights"), f"{TABLES}/height.png"],
        mb=1000,
    ),
    "film_height_table": table(
        "film_height.csv",
        "Comparing the heights measured in {wildcards.dataset} with the true ones",
        {"heights": plan.of_films(f"{CELL}/height.json"), "truths": plan.of_films(f"{OBJECT}/film/truth")},
        method="film_heights",
        dataset=plan.of_kinds("films"),
        mb=1000,
    ),
    "bop_table": scores(
        "bop",
        "Gathering the detections' and poses' scores of {wildcards.dataset}",
        plan.scores,
        shown(f"{TABLES}/bop.md", "detection and poses", "bop"),
        plan.score_options(published=True),
    ),
    "detector_table": scores(
        "detectors",
        "Comparing detectors with regions by SAM and by FastSAM in {wildcards.dataset}",
        plan.compared_scores("precision", *plan.proposing),
        f"{TABLES}/detectors.md",
        plan.score_options(),
    ),
    "estimator_table": scores(
        "estimators",
        "Comparing FoundationPose with SAM-6D in {wildcards.dataset}",
        plan.compared_scores("scores", "foundationpose-cnos_sam", "sam6d_pem-sam6d_ism_sam"),
        f"{TABLES}/estimators.md",
        plan.score_options(),
    ),
    "robustness_table": table(
        "robustness.csv",
        "Gathering what poses of {wildcards.dataset} lose with damaged models",
        {"scores": plan.robustness_scores},
        method="robustness",
        options="",
        beside=[shown(f"{TABLES}/robustness.svg", "robustness of poses", "robustness"), f"{TABLES}/robustness.png"],
        mb=1000,
    ),
    "grasp_table": table(
        "grasp.csv",
        "Gathering the grasps of {wildcards.dataset} in simulation",
        {"attempts": plan.attempts, "scenes": plan.sightings},
        method="grasping",
        options="",
        writes={"page": shown(f"{TABLES}/grasp.md", "grasps in simulation", "grasp")},
    ),
    "grasp_scenes_table": table(
        "grasp_scenes.csv",
        "Gathering what robots make of several things of {wildcards.dataset}",
        {"scenes": plan.sightings},
        method="grasp_scenes",
        options="",
    ),
    "grasp_robustness_table": table(
        "grasp_robustness.csv",
        "Gathering how grasps of {wildcards.dataset} fail with damaged models",
        {"attempts": plan.damaged_attempts},
        method="grasp_robustness",
        options="",
        writes={
            "scale_plot": shown(f"{TABLES}/grasp_scale.svg", "grasps with a wrong scale", "grasp"),
            "underside_plot": shown(f"{TABLES}/grasp_underside.svg", "grasps without the underside", "grasp"),
        },
        beside=[f"{TABLES}/grasp_scale.png", f"{TABLES}/grasp_underside.png"],
        mb=1000,
    ),
}
# On a cluster, what takes a second is done where Snakemake runs.
for name, row in RULES.items():

    rule:
        name:
            name
        input:
            **row["reads"],
        output:
            row["beside"],
            **row["writes"],
            out=row["path"],
        log:
            row["log"],
        wildcard_constraints:
            dataset=row["dataset"],
        localrule: True
        resources:
            **needs(row["mb"], 5),
        params:
            method=row["method"],
            inputs=given(),
            options=row["options"],
            files=lambda wildcards, output: step_options(dict(output.items())),
        message:
            row["says"]
        shell:
            "python -m zeroshop_steps.report --method {params.method} {params.inputs} {params.options} {params.files} > {log} 2>&1"
