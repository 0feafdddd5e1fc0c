"""Finish: a raw mesh becomes a product: clean, textured, in the object frame, in millimetres."""


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
    steps = ("raw_mesh", "clean", "height", "closed", "unwrapped", "texture")
    return [path.format(**wildcards) for path in (*stereo, *training, *(f"{CELL}/{name}.json" for name in steps))]


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


rule clean:
    input:
        mesh=raw_mesh_of,
        cameras=f"{RUN}/cameras",
    output:
        mesh=f"{CELL}/clean.ply",
        facts=f"{CELL}/clean.json",
    log:
        f"{CELL}/logs/clean.log",
    benchmark:
        f"{CELL}/benchmarks/clean.tsv"
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        options=step_options(config["finish"]["clean"]),
    message:
        "Cleaning the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method clean --mesh {input.mesh} --cameras {input.cameras}"
        " {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"


rule close:
    input:
        mesh=f"{CELL}/clean.ply",
        height=f"{CELL}/height.json",
        cameras=f"{RUN}/cameras",
        generated=proposed_mesh,
        stereo=confirmed_depths,
    output:
        mesh=f"{CELL}/closed.ply",
        facts=f"{CELL}/closed.json",
    log:
        f"{CELL}/logs/close.log",
    benchmark:
        f"{CELL}/benchmarks/close.tsv"
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        options=step_options(
            {name: config["finish"][name] for name in ("underside", "holes", "hollows")}
            | {"max_faces": config["finish"]["clean"]["max_faces"]}
        ),
    message:
        "Closing the surface of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method close --mesh {input.mesh} --height {input.height} --cameras {input.cameras}"
        " --generated {input.generated} --stereo {input.stereo} {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"


rule frame:
    input:
        mesh=f"{CELL}/closed.ply",
        height=f"{CELL}/height.json",
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
    output:
        frame=f"{CELL}/frame.json",
    log:
        f"{CELL}/logs/frame.log",
    benchmark:
        f"{CELL}/benchmarks/frame.tsv"
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Finding the object frame of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method frame --mesh {input.mesh} --height {input.height} --cameras {input.cameras}"
        " --capture {input.capture} --out {output.frame} --record-failure {output} > {log} 2>&1"


rule unwrap:
    input:
        mesh=f"{CELL}/closed.ply",
    output:
        mesh=f"{CELL}/unwrapped.ply",
        facts=f"{CELL}/unwrapped.json",
    log:
        f"{CELL}/logs/unwrap.log",
    benchmark:
        f"{CELL}/benchmarks/unwrap.tsv"
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        texture_size_px=config["finish"]["texture_size_px"],
    message:
        "Unwrapping the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method unwrap --mesh {input.mesh} --texture-size {params.texture_size_px}"
        " --out {output.mesh} --record-failure {output} > {log} 2>&1"


rule texture:
    input:
        mesh=f"{CELL}/unwrapped.ply",
        cameras=f"{RUN}/cameras",
        generated=generated_mesh,
    output:
        texture=f"{CELL}/texture.png",
        facts=f"{CELL}/texture.json",
    log:
        f"{CELL}/logs/texture.log",
    benchmark:
        f"{CELL}/benchmarks/texture.tsv"
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
        gpu=int(config["finish"]["device"] != "cpu"),
        # At most all texels, 41 bytes each, and one photo, beside what CUDA itself takes.
        gpu_mem_mb=1000 + 41 * config["finish"]["texture_size_px"] ** 2 // 10**6 if config["finish"]["device"] != "cpu" else 0,
    params:
        options=step_options({"texture_size": config["finish"]["texture_size_px"], "device": config["finish"]["device"]}),
    message:
        "Baking the texture of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method texture --mesh {input.mesh} --cameras {input.cameras}"
        " --generated {input.generated} {params.options} --out {output.texture} --record-failure {output} > {log} 2>&1"


rule export:
    input:
        mesh=f"{CELL}/unwrapped.ply",
        texture=f"{CELL}/texture.png",
        frame=f"{CELL}/frame.json",
        capture=f"{SCENE}/capture",
        cameras=f"{RUN}/cameras",
        facts=stage_facts,
    output:
        mesh=f"{CELL}/mesh.ply",
        texture=f"{CELL}/mesh.png",
        glb=f"{CELL}/mesh.glb",
        facts=f"{CELL}/mesh.json",
    log:
        f"{CELL}/logs/export.log",
    benchmark:
        f"{CELL}/benchmarks/export.tsv"
    wildcard_constraints:
        registration=WITH_CAMERAS,
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Writing the finished mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method export --mesh {input.mesh} --texture {input.texture} --frame {input.frame}"
        " --stages {input.capture}/capture.json {input.cameras}/registration.json {input.facts}"
        " --out {output.mesh} > {log} 2>&1"


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
