"""Films: models filmed as a phone would, and how right the masks and heights are that come out of it.

results/DATASET/OBJECT/film/film.mp4           the film; from there on its dataset goes the way of a user's own
results/DATASET/tables/masks.csv               masks against the true ones, frame by frame
results/DATASET/tables/film_height.csv         heights by the printed board against the true ones
"""


localrules:
    mask_table,
    film_height_table,


rule film:
    input:
        model=filmed_model,
    output:
        film="results/{dataset}/{object}/film/film.mp4",
        empty_scene=directory("results/{dataset}/{object}/film/empty_scene"),
        truth=directory("results/{dataset}/{object}/film/truth"),
    log:
        "results/{dataset}/{object}/logs/film.log",
    benchmark:
        "results/{dataset}/{object}/benchmarks/film.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(20),
    params:
        board=film_board,
        seed=config["seed"],
        folder=lambda wildcards, output: os.path.dirname(output.film),
    message:
        "Filming {wildcards.object}"
    shell:
        "python -m zeroshop_steps.synthetic --method film --model {input.model}/model.ply --board {params.board}"
        " --seed {params.seed} --threads {threads} --out {params.folder} > {log} 2>&1"


rule mask_error:
    input:
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        capture="results/{dataset}/{object}/{scene}/capture",
        truth="results/{dataset}/{object}/film/truth",
    output:
        table="results/{dataset}/{object}/{scene}/{registration}/mask_error.csv",
        picture="results/{dataset}/{object}/{scene}/{registration}/mask_error.png",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/logs/mask_error.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/benchmarks/mask_error.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Comparing the masks of {wildcards.object}, {wildcards.registration}, with the true ones"
    shell:
        "python -m zeroshop_steps.evaluate --method mask_error --cameras {input.cameras} --capture {input.capture} --truth {input.truth}"
        " --out {output.table} --record-failure {output} > {log} 2>&1"


rule mask_table:
    input:
        measurements=film_files("video/{registration}/mask_error.csv"),
    output:
        table="results/{dataset}/tables/masks.csv",
    log:
        "results/{dataset}/tables/logs/masks.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/masks.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Gathering how right the masks of {wildcards.dataset} are"
    shell:
        "python -m zeroshop_steps.report --method table --measurements {input.measurements} --out {output.table} > {log} 2>&1"


rule film_height_table:
    input:
        heights=film_files("video/{registration}/{nvs}/height.json"),
        truths=film_files("film/truth"),
    output:
        table="results/{dataset}/tables/film_height.csv",
    log:
        "results/{dataset}/tables/logs/film_height.log",
    benchmark:
        "results/{dataset}/tables/benchmarks/film_height.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    message:
        "Comparing the heights measured in {wildcards.dataset} with the true ones"
    shell:
        "python -m zeroshop_steps.report --method film_heights --heights {input.heights} --truths {input.truths}"
        " --out {output.table} > {log} 2>&1"
