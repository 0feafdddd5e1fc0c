"""Grasp: where a gripper can take the object, and how the object rests on a table.

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/grasps.json, .npy, .png   of any cell
results/DATASET/OBJECT/NVS.grasps.json, .npy, .png                      of the chosen cell
"""

GRASP_FILES = {"grasps": "grasps.json", "array": "grasps.npy", "picture": "grasps.png"}


localrules:
    publish_grasps,


rule grasps:
    input:
        mesh=f"{CELL}/mesh.ply",
        facts=f"{CELL}/mesh.json",
        evidence=f"{CELL}/evidence.npz",
    output:
        grasps=f"{CELL}/grasps.json",
        array=f"{CELL}/grasps.npy",
    log:
        f"{CELL}/logs/grasps.log",
    resources:
        **needs(2000, 5),
    params:
        options=step_options({**settings["grasp"], "seed": settings["seed"]}),
    message:
        "Finding grasps of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.grasp --method antipodal --mesh {input.mesh} --evidence {input.evidence} {params.options}"
        " --out {output.grasps} --record-failure {output} > {log} 2>&1"


rule grasp_picture:
    input:
        mesh=f"{CELL}/mesh.ply",
        facts=f"{CELL}/mesh.json",
        grasps=f"{CELL}/grasps.json",
    output:
        picture=f"{CELL}/grasps.png",
    log:
        f"{CELL}/logs/grasp_picture.log",
    resources:
        **needs(1000, 5),
    params:
        options=step_options({"unknown_scale": settings["grasp"]["unknown_scale"]}),
    message:
        "Drawing the best grasps of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.grasp --method picture --mesh {input.mesh} --grasps {input.grasps} {params.options}"
        " --out {output.picture} --record-failure {output} > {log} 2>&1"


rule publish_grasps:
    input:
        plan.in_chosen_cell(*GRASP_FILES.values()),
    output:
        **{name: f"{OBJECT}/{{nvs}}.{file}" for name, file in GRASP_FILES.items()},
    log:
        f"{OBJECT}/logs/publish_grasps.{{nvs}}.log",
    resources:
        **needs(100, 5),
    message:
        "Linking the grasps of the chosen cell of {wildcards.object}"
    shell:
        "python -m zeroshop_steps.finish --method link_mesh --files {input} --links {output} > {log} 2>&1"
