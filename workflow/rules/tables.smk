"""Tables: the measurements of a dataset, one a row, and pages made of them.

results/DATASET/tables/cameras.csv                    how right the cameras are
results/DATASET/tables/reconstruction.csv, .md        grades and figures of every cell; its grades as marks
results/DATASET/tables/height.csv, height.svg         how far a printed board is off (thesis, Tables 4.3 and 4.4, Figure 4.8)
results/DATASET/tables/masks.csv, film_height.csv     of films: masks frame by frame, heights by the printed board
results/DATASET/tables/bop.csv, bop.md                detections and poses; bop.json: the settings that they were made with
results/DATASET/tables/detectors.csv, detectors.md    CNOS and SAM-6D, each with regions by SAM and by FastSAM (thesis, 4.4.1)
results/DATASET/tables/estimators.csv, estimators.md  FoundationPose beside SAM-6D, regions by SAM (thesis, 4.4.2)

For the table of heights every object is measured twice: with the board beside it in its views (scene su_b), and by photos of the empty
scene with the board, while its views (su_h) show none.
"""

import json


def cameras_of_table(
    wildcards,
):
    """How right the cameras of each registration in the tables are."""
    return list(dict.fromkeys(f"{RUN}/camera_error.csv".format(**cell) for cell in cells_of_table(wildcards)))


def heights_of_table(
    wildcards,
):
    """The height of every object of a dataset by the board, beside it and in the empty scene, and by MASt3R if it can run here.

    Of the user's own photos, those objects whose height is known and that have photos of the empty scene, by MASt3R alone. Failures are
    rows of the table.
    """
    nvs = surfaces_with_cameras("the table of heights")[0]
    cell = {"dataset": wildcards.dataset, "nvs": nvs}
    if dataset_named(wildcards.dataset)["kind"] == "photos":
        rows = {name: row for (owner, name), row in PHOTOS.items() if owner == wildcards.dataset}
        known = [name for name, row in rows.items() if row["height_m"] and row["marker_images"]]
        if RECORDS_REFUSALS:
            known = filmed_objects(known)
        if not known:
            raise WorkflowError(
                f"{config['objects_table']}: no object of {wildcards.dataset} has both height_m and marker_images to compare"
            )
        cell |= {"scene": WHOLE_SCENE, "registration": config["chosen"]["photos"]["registration"]}
        return [f"{CELL}/height_by_mast3r.json".format(**cell, object=name) for name in known]
    virtual_dataset(wildcards.dataset)
    cell |= {"registration": config["chosen"]["virtual"]["registration"]}
    means = [("height_by_board", BOARD_SCENE), ("height_by_board", "su_h")]
    means += [] if methods.lacks(HEIGHTS["mast3r"]) else [("height_by_mast3r", "su_h")]
    return [
        f"{CELL}/{file}.json".format(**cell, object=name, scene=scene) for name in objects_of(wildcards.dataset) for file, scene in means
    ]


def film_files(
    path,
):
    """An input function: this file of every film of a dataset, a failure where it could not be made."""

    def files(
        wildcards,
    ):
        registration, nvs = config["chosen"]["photos"]["registration"], surfaces_with_cameras("the table of films")[0]
        run = {"dataset": wildcards.dataset, "scene": WHOLE_SCENE, "registration": registration, "nvs": nvs}
        return [path.format(**run, object=name) for name in objects_of(wildcards.dataset)]

    return files


def scores_of_table(
    wildcards,
):
    """The scores of every detector and estimator that the config wants in tables, with true and with reconstructed models."""
    virtual_dataset(wildcards.dataset, "Photos have no test set.")
    say_what_is_left_out("nvs", "detectors", "estimators")
    detectors, estimators = table_axis("detectors"), table_axis("estimators")
    runs = [f"{detector}-MODELS/precision" for detector in detectors]
    pairs = [f"{estimator}-{masks}" for estimator in estimators for masks in ["truth", *detectors]]
    runs += [f"{pair}-MODELS/scores" for pair in (pairs if config["tables"]["poses"] == "all" else config["tables"]["poses"])]
    folders = ["models", *(f"models_{nvs}" for nvs in surfaces_with_cameras("the table of the benchmark"))]
    return [f"{RESULTS}/{wildcards.dataset}/bop/{run.replace('MODELS', models)}.csv" for models in folders for run in runs]


def scores_of_comparison(
    kind,
    *runs,
):
    """An input function: scores of these runs with true models, with the same without underside, and with reconstructed ones."""

    def scores(
        wildcards,
    ):
        virtual_dataset(wildcards.dataset, "Photos have no test set.")
        folders = ["models", "models_without_underside", *(f"models_{nvs}" for nvs in measured_surfaces(f"the table of {kind}"))]
        return [f"{BOP}/{run}-{models}/{kind}.csv".format(**wildcards) for models in folders for run in runs]

    return scores


def settings_of_scores(
    wildcards,
):
    """What tells a table of scores from others: the test images, the cells of its models, and the options of its networks; as JSON."""
    test_folder = config["datasets"][wildcards.dataset].get("test_folder")
    networks = {stage: config[stage] for stage in ("detect", "pose")}
    return json.dumps({"test_folder": test_folder, **config["chosen"]["virtual"], **networks})


def published_option(
    wildcards,
):
    """The option that puts published figures beside ours, for the dataset that has some."""
    return "--published" if wildcards.dataset == "ycbv" else ""


localrules:
    camera_table,
    reconstruction_table,
    reconstruction_marks,
    mask_table,
    film_height_table,
    bop_table,
    detector_table,
    estimator_table,


rule camera_table:
    input:
        measurements=cameras_of_table,
    output:
        table=report(
            f"{TABLES}/cameras.csv",
            caption="../report/cameras.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "camera errors"},
        ),
    log:
        f"{TABLES}/logs/cameras.log",
    benchmark:
        f"{TABLES}/benchmarks/cameras.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Gathering the camera errors of every registration of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input}" f"{BELOW_RESULTS}" " --out {output} > {log} 2>&1"


use rule camera_table as reconstruction_table with:
    input:
        cells=figures_of(rows_of_table),
    output:
        table=report(
            f"{TABLES}/reconstruction.csv",
            caption="../report/reconstruction.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "figures"},
        ),
    log:
        f"{TABLES}/logs/reconstruction.log",
    benchmark:
        f"{TABLES}/benchmarks/reconstruction.tsv"
    message:
        "Gathering the grade and the quality of every cell of {wildcards.dataset}"


use rule camera_table as mask_table with:
    input:
        measurements=film_files(f"{RUN}/mask_error.csv"),
    output:
        table=f"{TABLES}/masks.csv",
    log:
        f"{TABLES}/logs/masks.log",
    benchmark:
        f"{TABLES}/benchmarks/masks.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    message:
        "Gathering how right the masks of {wildcards.dataset} are"


rule reconstruction_marks:
    input:
        table=f"{TABLES}/reconstruction.csv",
    output:
        page=report(
            f"{TABLES}/reconstruction.md",
            caption="../report/marks.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "grades"},
        ),
    log:
        f"{TABLES}/logs/reconstruction_marks.log",
    benchmark:
        f"{TABLES}/benchmarks/reconstruction_marks.tsv"
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    params:
        published=published_option,
    message:
        "Marking every cell of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method reconstruction --table {input.table} {params.published} --out {output.page} > {log} 2>&1"


rule height_table:
    input:
        heights=heights_of_table,
    output:
        table=report(
            f"{TABLES}/height.csv",
            caption="../report/heights.rst",
            category="Heights",
            subcategory="{dataset}",
            labels={"table": "heights"},
        ),
        plot=report(
            f"{TABLES}/height.svg",
            caption="../report/heights.rst",
            category="Heights",
            subcategory="{dataset}",
            labels={"table": "Figure 4.8"},
        ),
        picture=f"{TABLES}/height.png",
    log:
        f"{TABLES}/logs/height.log",
    benchmark:
        f"{TABLES}/benchmarks/height.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Comparing the measured heights of {wildcards.dataset} with the true ones"
    shell:
        "python -m zeroshop_steps.report --method heights --heights {input.heights}" f"{BELOW_RESULTS}" " --out {output.table} > {log} 2>&1"


rule film_height_table:
    input:
        heights=film_files(f"{CELL}/height.json"),
        truths=film_files(f"{OBJECT}/film/truth"),
    output:
        table=f"{TABLES}/film_height.csv",
    log:
        f"{TABLES}/logs/film_height.log",
    benchmark:
        f"{TABLES}/benchmarks/film_height.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Comparing the heights measured in {wildcards.dataset} with the true ones"
    shell:
        "python -m zeroshop_steps.report --method film_heights --heights {input.heights} --truths {input.truths}"
        f"{BELOW_RESULTS}"
        " --out {output.table} > {log} 2>&1"


rule bop_table:
    input:
        scores=scores_of_table,
    output:
        table=f"{TABLES}/bop.csv",
        page=report(
            f"{TABLES}/bop.md",
            caption="../report/bop.rst",
            category="Tables",
            subcategory="{dataset}",
            labels={"table": "detection and poses"},
        ),
        settings=f"{TABLES}/bop.json",
    log:
        f"{TABLES}/logs/bop.log",
    benchmark:
        f"{TABLES}/benchmarks/bop.tsv"
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    params:
        published=published_option,
        images=lambda wildcards: "--real-images" if has_real_tests(wildcards.dataset) else "",
        settings=settings_of_scores,
    message:
        "Gathering the detections' and poses' scores of {wildcards.dataset}"
    shell:
        "python -m zeroshop_steps.report --method bop --scores {input.scores} {params.published} {params.images} --page {output.page}"
        " --settings {params.settings:q} --settings-out {output.settings}"
        f"{BELOW_RESULTS}"
        " --out {output.table} > {log} 2>&1"


use rule bop_table as detector_table with:
    input:
        scores=scores_of_comparison("precision", *PROPOSING),
    output:
        table=f"{TABLES}/detectors.csv",
        page=f"{TABLES}/detectors.md",
        settings=f"{TABLES}/detectors.json",
    log:
        f"{TABLES}/logs/detectors.log",
    benchmark:
        f"{TABLES}/benchmarks/detectors.tsv"
    params:
        published="",
        images=lambda wildcards: "--real-images" if has_real_tests(wildcards.dataset) else "",
        settings=settings_of_scores,
    message:
        "Comparing detectors with regions by SAM and by FastSAM in {wildcards.dataset}"


use rule detector_table as estimator_table with:
    input:
        scores=scores_of_comparison("scores", "foundationpose-cnos_sam", "sam6d_pem-sam6d_ism_sam"),
    output:
        table=f"{TABLES}/estimators.csv",
        page=f"{TABLES}/estimators.md",
        settings=f"{TABLES}/estimators.json",
    log:
        f"{TABLES}/logs/estimators.log",
    benchmark:
        f"{TABLES}/benchmarks/estimators.tsv"
    message:
        "Comparing FoundationPose with SAM-6D in {wildcards.dataset}"
