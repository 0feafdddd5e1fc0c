"""Films: rendered films of models, as a phone takes them; from there on their dataset goes the way of a user's own.

results/DATASET/OBJECT/film     the film, photos of the empty scene with a printed board, and the truth
results/DATASET/OBJECT/film_2   another one, for which the object was turned over, where the dataset has two passes
"""


def filmed_object(
    wildcards,
):
    """The folder of the object that is filmed, in its own dataset."""
    check_object(wildcards)
    of = config["datasets"][wildcards.dataset]["of"]
    [dataset] = [name for name, names in of.items() if wildcards.object in names]
    return f"{RESULTS}/{virtual_dataset(dataset, 'Films are of models.')}/{wildcards.object}"


def filmed_model(
    wildcards,
):
    """The model that is filmed."""
    return f"{filmed_object(wildcards)}/model"


def filmed_turned_model(
    wildcards,
):
    """The same model as it lies in the second pass."""
    return f"{filmed_object(wildcards)}/turned_model"


def film_options(
    wildcards,
):
    """Where the printed board of a dataset's films lies, and what the table's top looks like."""
    described = config["datasets"][wildcards.dataset]
    return step_options({"board": described["board"], "table": described.get("table", "print")})


rule film:
    input:
        model=filmed_model,
    output:
        film=f"{OBJECT}/film/film.mp4",
        empty_scene=directory(f"{OBJECT}/film/empty_scene"),
        truth=directory(f"{OBJECT}/film/truth"),
    log:
        f"{OBJECT}/logs/film.log",
    benchmark:
        f"{OBJECT}/benchmarks/film.tsv"
    wildcard_constraints:
        dataset=datasets_of("films"),
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(20),
    params:
        options=film_options,
        seed=config["seed"],
        folder=subpath(output.film, parent=True),
    message:
        "Filming {wildcards.object}"
    shell:
        "python -m zeroshop_steps.synthetic --method film --model {input.model}/model.ply {params.options}"
        " --seed {params.seed} --threads {threads} --out {params.folder} > {log} 2>&1"


use rule film as turned_film with:
    input:
        model=filmed_turned_model,
    output:
        film=f"{OBJECT}/film_2/film.mp4",
        empty_scene=directory(f"{OBJECT}/film_2/empty_scene"),
        truth=directory(f"{OBJECT}/film_2/truth"),
    log:
        f"{OBJECT}/logs/film_2.log",
    benchmark:
        f"{OBJECT}/benchmarks/film_2.tsv"
    params:
        options=film_options,
        seed=config["seed"] + 1,  # on another table
        folder=subpath(output.film, parent=True),
    message:
        "Filming {wildcards.object} turned over"
