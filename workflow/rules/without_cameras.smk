"""Cells of a generative method without cameras: the mesh is finished, all of it is marked as never seen, and it has no grade."""


def generated_without_cameras(
    wildcards,
):
    """The mesh that a generative method makes of a capture alone, with its figures; other cells without cameras have nothing to finish."""
    check_object(wildcards)
    usable("nvs method", wildcards.nvs, SURFACES, "The folder is named after the method.")
    if not surface_method(wildcards.nvs).generated:
        refuse_without_cameras(wildcards)
    return [f"{CELL}/raw_mesh.{end}".format(**wildcards) for end in ("ply", "json")]


rule finish_without_cameras:
    input:
        raw=generated_without_cameras,
        capture=f"{SCENE}/capture",
    output:
        mesh=f"{CELL}/mesh.ply",
        texture=f"{CELL}/mesh.png",
        glb=f"{CELL}/mesh.glb",
        facts=f"{CELL}/mesh.json",
    log:
        f"{CELL}/logs/finish.log",
    benchmark:
        f"{CELL}/benchmarks/finish.tsv"
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(15),
    params:
        options=step_options(config["finish"]["clean"]),
        finish=step_options({"holes": config["finish"]["holes"], "texture_size": config["finish"]["texture_size_px"]}),
    message:
        "Finishing the generated mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, without cameras"
    shell:
        "python -m zeroshop_steps.finish --method without_cameras --mesh {input.raw[0]} --stages {input.capture}/capture.json"
        " {params.options} {params.finish} --out {output.mesh} > {log} 2>&1"


rule preview_without_cameras:
    input:
        mesh=f"{CELL}/mesh.ply",
    output:
        preview=f"{CELL}/mesh_preview.png",
    log:
        f"{CELL}/logs/preview.log",
    benchmark:
        f"{CELL}/benchmarks/preview.tsv"
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Rendering the generated mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, from around"
    shell:
        "python -m zeroshop_steps.finish --method preview --mesh {input.mesh} --out {output.preview} > {log} 2>&1"


rule evidence_without_cameras:
    input:
        mesh=f"{CELL}/mesh.ply",
    output:
        evidence=f"{CELL}/evidence.npz",
        figures=f"{CELL}/evidence.json",
    log:
        f"{CELL}/logs/evidence.log",
    benchmark:
        f"{CELL}/benchmarks/evidence.tsv"
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Marking the generated mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, as never seen"
    shell:
        "python -m zeroshop_steps.evaluate --method surface_support --mesh {input.mesh} --out {output.evidence} > {log} 2>&1"


rule grade_without_cameras:
    input:
        mesh=f"{CELL}/mesh.ply",
    output:
        grade=f"{CELL}/grade.json",
        table=f"{CELL}/grade.csv",
    log:
        f"{CELL}/logs/grade.log",
    benchmark:
        f"{CELL}/benchmarks/grade.tsv"
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        options=step_options(config["finish"]["grade"]),
    message:
        "Noting that the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, is not graded"
    shell:
        "python -m zeroshop_steps.evaluate --method grade --mesh {input.mesh} {params.options} --out {output.grade} > {log} 2>&1"
