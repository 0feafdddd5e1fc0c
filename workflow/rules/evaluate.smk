"""Evaluate: what of a mesh was measured, its grade, and, where the truth is known, how right cameras, masks and meshes are."""

from zeroshop_steps.evaluate.grading import check_limits

try:
    for name, limits in settings["finish"]["grade"].items():
        check_limits(name, limits)
except StepError as error:
    raise WorkflowError(str(error)) from None


rule camera_error:
    input:
        cameras=f"{RUN}/cameras",
        capture=plan.capture_of,
        film_truth=plan.film_truth,
    output:
        figures=f"{RUN}/camera_error.json",
        table=f"{RUN}/camera_error.csv",
    log:
        f"{RUN}/logs/camera_error.log",
    wildcard_constraints:
        dataset=plan.of_kinds("demo", "bop", "films"),
    resources:
        **needs(1000, 5),
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
        truth=plan.film_truth,
    output:
        table=f"{RUN}/mask_error.csv",
        picture=f"{RUN}/mask_error.png",
    log:
        f"{RUN}/logs/mask_error.log",
    wildcard_constraints:
        dataset=plan.of_kinds("films"),
    resources:
        **needs(1000, 5),
    message:
        "Comparing the masks of {wildcards.object}, {wildcards.registration}, with the true ones"
    shell:
        "python -m zeroshop_steps.evaluate --method mask_error --cameras {input.cameras} --capture {input.capture} --truth {input.truth}"
        " --out {output.table} --record-failure {output} > {log} 2>&1"


# Without cameras, a mesh was never seen and is not graded; without a truth, it has no quality.
SEEN = {"mesh": f"{CELL}/mesh.ply", "cameras": f"{RUN}/cameras", "stereo": plan.confirmed_depths}
TRUE = {"model": plan.true_model, "capture": f"{SCENE}/capture", "film_truth": plan.film_truth}
GRADES = {"grade": f"{CELL}/grade.json", "grade_table": f"{CELL}/grade.csv"}
QUALITY = {"quality": f"{CELL}/quality.json", "quality_table": f"{CELL}/quality.csv"}
VIEWS = {"evidence": f"{CELL}/evidence.npz", "preview": f"{CELL}/mesh_preview.png"}
GRADE = "Grading the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
UNSEEN = "Noting that the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, was never seen and is not graded"
# By rule: the datasets, the registration, what it reads and writes, what it takes of a GPU's memory, and what it says. One photo's pixels,
# 8 bytes each, and the mesh are there, beside what CUDA itself takes.
GPU_MB = 1500 if settings["finish"]["device"] != "cpu" else 0
EVALUATIONS = {
    "evaluate": (plan.of_kinds("demo", "bop", "films"), WITH_CAMERAS, SEEN | TRUE, GRADES | QUALITY | VIEWS, GPU_MB, GRADE),
    "evaluate_photos": (plan.of_kinds("photos"), WITH_CAMERAS, SEEN, GRADES | VIEWS, GPU_MB, GRADE),
    "evaluate_without_cameras": (plan.of_kinds("photos"), methods.WITHOUT_CAMERAS, {"mesh": SEEN["mesh"]}, GRADES | VIEWS, None, UNSEEN),
}
for name, (datasets, registration, reads, writes, gpu_mb, says) in EVALUATIONS.items():

    rule:
        name:
            name
        input:
            **reads,
        output:
            **writes,
        log:
            f"{CELL}/logs/evaluate.log",
        wildcard_constraints:
            dataset=datasets,
            registration=registration,
        resources:
            **needs(3000, 10, gpu_mb),
        params:
            inputs=given(),
            options=step_options({"device": settings["finish"]["device"], **settings["finish"]["grade"]}),
        message:
            says
        shell:
            "python -m zeroshop_steps.evaluate --method finished_mesh {params.inputs} {params.options}"
            " --out {output.grade} --record-failure {output} > {log} 2>&1"
