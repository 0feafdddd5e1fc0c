"""Evaluate: what of a mesh was measured, its grade, and, where the truth is known, how right cameras, masks and meshes are."""

from zeroshop_steps.evaluate.grading import check_limits

try:
    for name, limits in config["finish"]["grade"].items():
        check_limits(name, limits)
except StepError as error:
    raise WorkflowError(str(error)) from None


def film_truth_of(
    wildcards,
):
    """The truth of a rendered film; a virtual capture, and that of joined films, have their own."""
    if not is_filmed(wildcards.dataset) or wildcards.scene == JOINED_PHOTOS:
        return []
    return [f"{OBJECT}/{'film_2' if wildcards.scene in LATER_PASSES else 'film'}/truth".format(**wildcards)]


def true_model_of(
    wildcards,
):
    """The model that was rendered or filmed."""
    return filmed_model(wildcards) if is_filmed(wildcards.dataset) else f"{OBJECT}/model".format(**wildcards)


rule camera_error:
    input:
        cameras=f"{RUN}/cameras",
        capture=capture_of,
        film_truth=film_truth_of,
    output:
        figures=f"{RUN}/camera_error.json",
        table=f"{RUN}/camera_error.csv",
    log:
        f"{RUN}/logs/camera_error.log",
    benchmark:
        f"{RUN}/benchmarks/camera_error.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop", "films"),
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        truth=lambda wildcards, input: (
            f"{input.film_truth} --film-capture {input.capture}" if input.film_truth else f"{input.capture}/truth"
        ),
    message:
        "Comparing the cameras of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, with the true ones"
    shell:
        "python -m zeroshop_steps.evaluate --method camera_error --cameras {input.cameras} --truth {params.truth}"
        " --out {output.figures} > {log} 2>&1"


rule mask_error:
    input:
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        truth=film_truth_of,
    output:
        table=f"{RUN}/mask_error.csv",
        picture=f"{RUN}/mask_error.png",
    log:
        f"{RUN}/logs/mask_error.log",
    benchmark:
        f"{RUN}/benchmarks/mask_error.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Comparing the masks of {wildcards.object}, {wildcards.registration}, with the true ones"
    shell:
        "python -m zeroshop_steps.evaluate --method mask_error --cameras {input.cameras} --capture {input.capture} --truth {input.truth}"
        " --out {output.table} --record-failure {output} > {log} 2>&1"


rule evaluate:
    input:
        mesh=f"{CELL}/mesh.ply",
        cameras=f"{RUN}/cameras",
        stereo=confirmed_depths,
        model=true_model_of,
        capture=f"{SCENE}/capture",
        film_truth=film_truth_of,
    output:
        grade=f"{CELL}/grade.json",
        grade_table=f"{CELL}/grade.csv",
        quality=f"{CELL}/quality.json",
        quality_table=f"{CELL}/quality.csv",
        evidence=f"{CELL}/evidence.npz",
        preview=f"{CELL}/mesh_preview.png",
    log:
        f"{CELL}/logs/evaluate.log",
    benchmark:
        f"{CELL}/benchmarks/evaluate.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop", "films"),
        registration=WITH_CAMERAS,
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
        gpu=int(config["finish"]["device"] != "cpu"),
        # One photo's pixels, 8 bytes each, and the mesh, beside what CUDA itself takes.
        gpu_mem_mb=1500 if config["finish"]["device"] != "cpu" else 0,
    params:
        inputs=inputs_as_options,
        options=step_options({"device": config["finish"]["device"], **config["finish"]["grade"]}),
    message:
        "Grading the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.evaluate --method finished_mesh {params.inputs} {params.options}"
        " --out {output.grade} --record-failure {output} > {log} 2>&1"


use rule evaluate as evaluate_photos with:
    input:
        mesh=f"{CELL}/mesh.ply",
        cameras=f"{RUN}/cameras",
        stereo=confirmed_depths,
    output:
        grade=f"{CELL}/grade.json",
        grade_table=f"{CELL}/grade.csv",
        evidence=f"{CELL}/evidence.npz",
        preview=f"{CELL}/mesh_preview.png",
    wildcard_constraints:
        dataset=datasets_of("photos"),
        registration=WITH_CAMERAS,
