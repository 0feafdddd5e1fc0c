"""Height: how many metres the object is high, and a unit of its registration long; how well that is known.

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/height.json   by the method of its row in objects.tsv; rendered heights are known
results/DATASET/tables/height.csv, height.svg               how far a printed board is off (thesis, Tables 4.3 and 4.4, Figure 4.8)

For the table every object is measured twice: with the board beside it in its views (scene su_b), and by photos of the empty
scene with the board, while its views (su_h) show none.
"""


rule height:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/clean.ply",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        capture="results/{dataset}/{object}/{scene}/capture",
        stereo="results/{dataset}/{object}/{scene}/{registration}/stereo/seeds.npz",
        marker_images=extra_photos("marker_images"),
        depth=extra_photos("depth"),
    output:
        height="results/{dataset}/{object}/{scene}/{registration}/{nvs}/height.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/height.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/height.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: height_needs(wildcards).mem_mb * attempt,
        runtime=lambda wildcards, attempt: height_needs(wildcards).runtime_min * attempt,
        gpu=lambda wildcards: int(bool(height_needs(wildcards).weights)),
    params:
        method=height_method,
        options=height_options,
        weights=lambda wildcards: weights_stamp("height", height_method(wildcards), height_needs(wildcards)),
    message:
        "Measuring the height of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.height --method {params.method} --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --stereo {input.stereo} {params.options} --out {output.height}"
        " --record-failure {output} > {log} 2>&1"


rule capture_with_board:
    input:
        model="results/{dataset}/{object}/model",
    output:
        capture=directory("results/{dataset}/{object}/su_b/capture"),
    log:
        "results/{dataset}/{object}/su_b/logs/capture.log",
    benchmark:
        "results/{dataset}/{object}/su_b/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(10),
    params:
        width_px=config["capture"]["image_width_px"],
        height_px=config["capture"]["image_height_px"],
        seed=config["seed"],
    message:
        "Rendering the views of {wildcards.object} beside a printed board"
    shell:
        "python -m zeroshop_steps.synthetic --method board_scene --view object --model {input.model}/model.ply"
        " --width {params.width_px} --height {params.height_px} --seed {params.seed} --threads {threads} --out {output.capture} > {log} 2>&1"


rule capture_empty_scene:
    input:
        model="results/{dataset}/{object}/model",
    output:
        photos=directory("results/{dataset}/{object}/su_h/empty_scene"),
    log:
        "results/{dataset}/{object}/su_h/logs/empty_scene.log",
    benchmark:
        "results/{dataset}/{object}/su_h/benchmarks/empty_scene.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(10),
    params:
        width_px=config["capture"]["image_width_px"],
        height_px=config["capture"]["image_height_px"],
        seed=config["seed"],
    message:
        "Rendering the empty scene of {wildcards.object} with a printed board"
    shell:
        "python -m zeroshop_steps.synthetic --method board_scene --view empty --model {input.model}/model.ply"
        " --width {params.width_px} --height {params.height_px} --seed {params.seed} --threads {threads} --out {output.photos} > {log} 2>&1"


rule height_by_board:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/clean.ply",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        capture="results/{dataset}/{object}/{scene}/capture",
        stereo="results/{dataset}/{object}/{scene}/{registration}/stereo/seeds.npz",
        empty_scene=empty_scene_of,
    output:
        height="results/{dataset}/{object}/{scene}/{registration}/{nvs}/height_by_board.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/height_by_board.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/height_by_board.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
        scene=f"su_h|{BOARD_SCENE}",
    conda:
        "../envs/zeroshop.yaml"
    threads: 2
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        options=step_options({**config["height"]["marker"], "seed": config["seed"]}),
        photos=empty_scene_option,
    message:
        "Measuring {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}, by the printed board"
    shell:
        "python -m zeroshop_steps.height --method marker --blind --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --stereo {input.stereo} {params.photos} {params.options} --threads {threads} --out {output.height}"
        " --record-failure {output} > {log} 2>&1"


rule height_table:
    input:
        heights=board_cells,
    output:
        table=report(
            "results/{dataset}/tables/height.csv",
            caption="../report/heights.rst",
            category="Heights",
            subcategory="{dataset}",
            labels={"table": "heights"},
        ),
        plot=report(
            "results/{dataset}/tables/height.svg",
            caption="../report/heights.rst",
            category="Heights",
            subcategory="{dataset}",
            labels={"table": "Figure 4.8"},
        ),
        picture="results/{dataset}/tables/height.png",
    log:
        "results/{dataset}/tables/logs/height.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/height.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Comparing the measured heights of {wildcards.dataset} with the true ones"
    shell:
        "python -m zeroshop_steps.report --method heights --heights {input.heights} --out {output.table} > {log} 2>&1"
