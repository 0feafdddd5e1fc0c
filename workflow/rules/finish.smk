"""Finish: a raw mesh becomes a product: clean, textured, in the object frame, in millimetres; that of the chosen cell is published.

results/DATASET/OBJECT/NVS.{ply,png,glb,json,preview.png}   the mesh of the chosen cell; DATASET/NAME/NVS.ply links to it, where NAME is
                                                            another name of the object, such as mustard_bottle for obj_000005 of YCB-V
A cell of a generative method without cameras (registration none) is finished, all of it is marked as never seen, and it has no grade.
"""

from zeroshop_steps.plan.datasets import NAMED_FILES

SHAPE = {**settings["finish"]["clean"], **{name: settings["finish"][name] for name in ("underside", "holes", "hollows")}}
TEXTURE = {"texture_size": settings["finish"]["texture_size_px"]}
# All texels at most, 41 bytes each, and one photo, beside what CUDA itself takes.
TEXTURE_MB = 1000 + 41 * settings["finish"]["texture_size_px"] ** 2 // 10**6 if settings["finish"]["device"] != "cpu" else 0
FINISHED = {
    "mesh": f"{CELL}/mesh.ply",
    "texture": f"{CELL}/mesh.png",
    "glb": f"{CELL}/mesh.glb",
    "facts": f"{CELL}/mesh.json",
}


# On a cluster, what takes a second is done where Snakemake runs.
localrules:
    publish,
    name_mesh,
    outcome_without_cameras,


rule shape:
    input:
        mesh=plan.raw_mesh,
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        stereo=plan.confirmed_depths,
        generated=plan.proposed_mesh,
        marker_images=plan.height_photos("marker_images"),
        depth=plan.height_photos("depth"),
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
    threads: 2
    resources:
        **needs_of("height", plan.height, 3000, lambda wildcards: 20 + plan.height(wildcards).runtime_min),
    params:
        options=step_options(SHAPE),
        height=plan.height_method,
        height_options=plan.height_options,
        weights=plan.height_weights,
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
        generated=plan.generated_mesh,
        facts=plan.stage_facts,
    output:
        **FINISHED,
    log:
        f"{CELL}/logs/texture.log",
    wildcard_constraints:
        registration=WITH_CAMERAS,
    resources:
        **needs(3000, 10, TEXTURE_MB),
    params:
        options=step_options({**TEXTURE, "device": settings["finish"]["device"]}),
        # When a run was asked for a mesh that records a failure: it is tried again, and the run ends with the reason.
        asked=lambda wildcards: (
            STARTED_S if FINISHED["mesh"].format(**wildcards) in workflow.dag_settings.targets and plan.has_failed(wildcards) else None
        ),
    message:
        "Texturing the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method texture --mesh {input.mesh} --frame {input.frame} --cameras {input.cameras}"
        " --generated {input.generated} --stages {input.capture}/capture.json {input.cameras}/registration.json {input.facts}"
        " {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"


rule publish:
    input:
        mesh=plan.in_chosen_cell("mesh.ply"),
        companions=plan.in_chosen_cell("mesh.png", "mesh.glb", "mesh.json"),
        preview=plan.in_chosen_cell("mesh_preview.png"),
        quality=plan.chosen_quality,
        grade=plan.in_chosen_cell("grade.json"),
        evidence=plan.in_chosen_cell("evidence.npz"),
    output:
        **{name: f"{OBJECT}/{{nvs}}.{end}" for name, end in NAMED_FILES.items() if name != "preview"},
        preview=report(
            f"{OBJECT}/{{nvs}}.preview.png",
            caption="../report/preview.rst",
            category="Meshes",
            subcategory="{dataset}",
            labels={"object": "{object}", "surface": "{nvs}"},
        ),
    log:
        f"{OBJECT}/logs/publish.{{nvs}}.log",
    resources:
        **needs(1000, 5),
    params:
        quality=given("quality"),
    message:
        "Putting the chosen mesh of {wildcards.object} at {output.mesh}"
    shell:
        "python -m zeroshop_steps.finish --method publish --mesh {input.mesh} --preview {input.preview}"
        " {params.quality} --grade {input.grade} --evidence {input.evidence} --out {output.mesh} > {log} 2>&1"


rule name_mesh:
    input:
        plan.named_files,
    output:
        **{name: f"{OBJECT}/{{nvs}}.{end}" for name, end in NAMED_FILES.items()},
    log:
        f"{OBJECT}/logs/name.{{nvs}}.log",
    wildcard_constraints:
        object=plan.named or NOTHING,
    resources:
        **needs(100, 5),
    message:
        "{wildcards.object} of {wildcards.dataset} is another name: linking the mesh at {output.mesh}"
    shell:
        "python -m zeroshop_steps.finish --method link_mesh --files {input} --links {output} > {log} 2>&1"


rule finish_without_cameras:
    input:
        raw=plan.generated_without_cameras,
        capture=f"{SCENE}/capture",
    output:
        **FINISHED,
    log:
        f"{CELL}/logs/finish.log",
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        **needs(3000, 15),
    params:
        options=step_options({**settings["finish"]["clean"], "holes": settings["finish"]["holes"], **TEXTURE}),
    message:
        "Finishing the generated mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, without cameras"
    shell:
        "python -m zeroshop_steps.finish --method without_cameras --mesh {input.raw[0]} --stages {input.capture}/capture.json"
        " {params.options} --out {output.mesh} > {log} 2>&1"


rule outcome_without_cameras:
    input:
        mesh=plan.raw_mesh,
    output:
        outcome=f"{CELL}/outcome.json",
    log:
        f"{CELL}/logs/outcome.log",
    wildcard_constraints:
        registration=methods.WITHOUT_CAMERAS,
    resources:
        **needs(500, 5),
    message:
        "Noting that {wildcards.object}, scene {wildcards.scene}, {wildcards.nvs}, ended with its raw mesh"
    shell:
        "python -m zeroshop_steps.evaluate --method outcome --mesh {input.mesh} --out {output.outcome}"
        " --record-failure {output} > {log} 2>&1"
