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


use rule evaluate_photos as evaluate_without_cameras with:
    input:
        mesh=f"{CELL}/mesh.ply",
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Noting that the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, was never seen and is not graded"
