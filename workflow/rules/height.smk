"""Height, measured for the table that compares it with the truth; that of a mesh is measured by `shape` (finish.smk).

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/height_by_board.json   by a printed board
results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/height_by_mast3r.json  by MASt3R, from two photos of the object and four of the empty scene
"""


rule height_by_board:
    input:
        mesh=f"{CELL}/clean.ply",
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        stereo=f"{RUN}/stereo/seeds.npz",
        empty_scene=plan.empty_scene,
    output:
        height=f"{CELL}/height_by_board.json",
    log:
        f"{CELL}/logs/height_by_board.log",
    wildcard_constraints:
        dataset=OF_MODELS,
        scene=f"su_h|{BOARD_SCENE}",
    threads: 2
    resources:
        **needs(3000, 10),
    params:
        options=plan.empty_scene_options,
    message:
        "Measuring {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}, by the printed board"
    shell:
        "python -m zeroshop_steps.height --method marker --blind --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --stereo {input.stereo} {params.options} --threads {threads} --out {output.height} --record-failure {output} > {log} 2>&1"


rule height_by_mast3r:
    input:
        mesh=f"{CELL}/clean.ply",
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        stereo=f"{RUN}/stereo/seeds.npz",
        photos=plan.mast3r_photos,
    output:
        height=f"{CELL}/height_by_mast3r.json",
    log:
        f"{CELL}/logs/height_by_mast3r.log",
    wildcard_constraints:
        dataset=plan.of_kinds("demo", "bop", "photos"),
        scene=f"su_h|{WHOLE_SCENE}",
    threads: 2
    resources:
        **needs(plan.heights["mast3r"].mem_mb, plan.heights["mast3r"].runtime_min, plan.heights["mast3r"].mem_mb),
    params:
        options=plan.mast3r_options,
        weights=plan.weights_stamp("height", plan.heights["mast3r"]),
    message:
        "Measuring {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}, by MASt3R"
    shell:
        "python -m zeroshop_steps.height --method mast3r --blind --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --stereo {input.stereo} {params.options} --out {output.height} --record-failure {output}"
        f"{AND_REFUSALS}"
        " > {log} 2>&1"
