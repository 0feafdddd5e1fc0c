"""Finish: a raw mesh becomes a product: clean, textured, in the object frame, in millimetres."""

from zeroshop_steps.runtime.failures import read_failure


def raw_mesh_of(
    wildcards,
):
    """The mesh that the nvs method of the path makes."""
    usable("nvs method", wildcards.nvs, SURFACES, "The folder is named after the method.")
    return f"{CELL}/raw_mesh.ply".format(**wildcards)


def proposed_mesh(
    wildcards,
):
    """The generated mesh that proposes what of a measured one no photo saw, where the config wants that."""
    method = surface_method(wildcards.nvs)
    if config["finish"]["unseen"] == "smooth" or method is None or method.generated:
        return []
    name = next(name for name, other in SURFACES.items() if other.generated)
    usable("nvs method", name, SURFACES, "finish.unseen: generated needs it.")
    return [f"{RUN}/{name}/raw_mesh.ply".format(**wildcards)]


def generated_mesh(
    wildcards,
):
    """The generated mesh whose colours the texture takes where no photo looks: of the cell itself, or of one that completes its mesh."""
    method = surface_method(wildcards.nvs)
    return [f"{CELL}/raw_mesh.ply".format(**wildcards)] if method is not None and method.generated else proposed_mesh(wildcards)


def stage_facts(
    wildcards,
):
    """The records of the stages behind a mesh, for its JSON."""
    method = surface_method(require_known("nvs method", wildcards.nvs, methods.SURFACES, "The folder is named after the method."))
    stereo = [f"{RUN}/stereo/stereo.json"] if method.stereo else []
    training = [f"{CELL}/{Path(method.model).parent}/training.json"] if method.model else []
    steps = ("raw_mesh", "clean", "height", "closed")
    return [path.format(**wildcards) for path in (*stereo, *training, *(f"{CELL}/{name}.json" for name in steps))]


def asked_again(
    wildcards,
):
    """When a run was asked for a mesh that records a failure: a parameter, so that it is tried again and the run ends with the reason."""
    mesh = f"{CELL}/mesh.ply".format(**wildcards)
    return STARTED_S if mesh in workflow.dag_settings.targets and read_failure(mesh) else None


def chosen_cell(
    wildcards,
):
    """The folder of the cell that the config chooses for an object."""
    check_object(wildcards)
    usable("nvs method", wildcards.nvs, SURFACES, "The file is named after the method.")
    return CELL.format(**wildcards, **chosen_run(wildcards))


def in_chosen_cell(
    *names,
):
    """An input function: these files of the chosen cell."""
    return lambda wildcards: [f"{chosen_cell(wildcards)}/{name}" for name in names]


def chosen_quality(
    wildcards,
):
    """The quality of the chosen cell, where there is a truth to measure against and cameras that align the mesh with it."""
    measured = knows_truth(wildcards.dataset) and chosen_run(wildcards)["registration"] != methods.WITHOUT_CAMERAS
    return [f"{chosen_cell(wildcards)}/quality.json"] if measured else []


def quality_option(
    wildcards,
    input,
):
    """The option that adds the quality to a JSON, where there is a truth to measure against."""
    return step_options({"quality": " ".join(input.quality) or None})


# On a cluster, what takes a second is done where Snakemake runs.
localrules:
    publish,


rule shape:
    input:
        mesh=raw_mesh_of,
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        stereo=confirmed_depths,
        generated=proposed_mesh,
        marker_images=extra_photos("marker_images"),
        depth=extra_photos("depth"),
    output:
        # In the order in which they are written: a failure is recorded in place of the first that is missing.
        cleaned=f"{CELL}/clean.ply",
        cleaned_facts=f"{CELL}/clean.json",
        height=f"{CELL}/height.json",
        mesh=f"{CELL}/closed.ply",
        facts=f"{CELL}/closed.json",
        frame=f"{CELL}/frame.json",
    log:
        f"{CELL}/logs/shape.log",
    benchmark:
        f"{CELL}/benchmarks/shape.tsv"
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: max(3000, height_needs(wildcards).mem_mb) * attempt,
        runtime=lambda wildcards, attempt: (20 + height_needs(wildcards).runtime_min) * attempt,
        gpu=gpu_of("height", height_needs),
        gpu_mem_mb=gpu_mem_of("height", height_needs),
    params:
        options=step_options({**config["finish"]["clean"], **{name: config["finish"][name] for name in ("underside", "holes", "hollows")}}),
        height=height_method,
        height_options=height_options,
        weights=lambda wildcards: weights_stamp("height", height_method(wildcards), height_needs(wildcards)),
    message:
        "Cleaning, measuring and closing the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method shape --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --generated {input.generated} --stereo {input.stereo} {params.options} --out {output.mesh} --record-failure {output}"
        f"{AND_REFUSALS}"
        " --height {params.height} {params.height_options} > {log} 2>&1"


rule texture:
    input:
        mesh=f"{CELL}/closed.ply",
        frame=f"{CELL}/frame.json",
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        generated=generated_mesh,
        facts=stage_facts,
    output:
        mesh=f"{CELL}/mesh.ply",
        texture=f"{CELL}/mesh.png",
        glb=f"{CELL}/mesh.glb",
        facts=f"{CELL}/mesh.json",
    log:
        f"{CELL}/logs/texture.log",
    benchmark:
        f"{CELL}/benchmarks/texture.tsv"
    wildcard_constraints:
        registration=WITH_CAMERAS,
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
        gpu=int(config["finish"]["device"] != "cpu"),
        # At most all texels, 41 bytes each, and one photo, beside what CUDA itself takes.
        gpu_mem_mb=1000 + 41 * config["finish"]["texture_size_px"] ** 2 // 10**6 if config["finish"]["device"] != "cpu" else 0,
    params:
        options=step_options({"texture_size": config["finish"]["texture_size_px"], "device": config["finish"]["device"]}),
        asked=asked_again,
    message:
        "Texturing the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method texture --mesh {input.mesh} --frame {input.frame} --cameras {input.cameras}"
        " --generated {input.generated} --stages {input.capture}/capture.json {input.cameras}/registration.json {input.facts}"
        " {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"


rule publish:
    input:
        mesh=in_chosen_cell("mesh.ply"),
        companions=in_chosen_cell("mesh.png", "mesh.glb", "mesh.json"),
        preview=in_chosen_cell("mesh_preview.png"),
        quality=chosen_quality,
        grade=in_chosen_cell("grade.json"),
        evidence=in_chosen_cell("evidence.npz"),
    output:
        mesh=f"{OBJECT}/{{nvs}}.ply",
        texture=f"{OBJECT}/{{nvs}}.png",
        glb=f"{OBJECT}/{{nvs}}.glb",
        facts=f"{OBJECT}/{{nvs}}.json",
        preview=report(
            f"{OBJECT}/{{nvs}}.preview.png",
            caption="../report/preview.rst",
            category="Meshes",
            subcategory="{dataset}",
            labels={"object": "{object}", "surface": "{nvs}"},
        ),
    log:
        f"{OBJECT}/logs/publish.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/publish.{{nvs}}.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        quality=quality_option,
    message:
        "Putting the chosen mesh of {wildcards.object} at {output.mesh}"
    shell:
        "python -m zeroshop_steps.finish --method publish --mesh {input.mesh} --preview {input.preview}"
        " {params.quality} --grade {input.grade} --evidence {input.evidence} --out {output.mesh} > {log} 2>&1"
