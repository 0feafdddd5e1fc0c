"""Synthetic: models whose true shape is known, and pictures and films rendered of them.

results/DATASET/OBJECT/model           a shop product made by code, or one of BOP's models
results/DATASET/OBJECT/SCENE/capture   rendered views of it (su_l, su_h, se; su_b with a printed board), with true cameras
results/DATASET/OBJECT/film            a film as a phone takes it, photos of the empty scene with a printed board, and the truth; its
                                       dataset goes the way of a user's own from there on
results/DATASET/OBJECT/film_2          another one, for which the object was turned over, where the dataset has two passes
"""

from zeroshop_steps.plan.captures import rendered_scene

# What BlenderProc's environment consists of.
BLENDER_REQUIREMENTS = os.path.relpath(PROJECT / "workflow/envs/blenderproc.txt")
RENDERER, TEST_RENDERER = (methods.RENDERERS[part["renderer"]] for part in (settings["capture"], settings["bop"]["test_set"]))
PICTURE_SIZE = step_options({"width": settings["capture"]["image_width_px"], "height": settings["capture"]["image_height_px"]})

# By rule: the method, the kind of datasets, minutes, further options and what it says.
MODELS = {
    "demo_model": ("demo_objects", "demo", 5, "", "Making the demo object {wildcards.object}"),
    "bop_model": ("bop_models", "bop", 60, plan.models_option, "Fetching the model of {wildcards.dataset} {wildcards.object}"),
}
for name, (method, kind, minutes, options, says) in MODELS.items():

    rule:
        name:
            name
        output:
            model=directory(f"{OBJECT}/model"),
        log:
            f"{OBJECT}/logs/model.log",
        wildcard_constraints:
            dataset=plan.of_kinds(kind),
        resources:
            **needs(2000, minutes),
        params:
            method=method,
            dataset="" if kind == "demo" else "--dataset {dataset}",
            object=plan.check_object,
            options=options,
        message:
            says
        shell:
            "python -m zeroshop_steps.synthetic --method {params.method} {params.dataset} --object {params.object} {params.options}"
            " --out {output.model} > {log} 2>&1"


rule turned_model:
    input:
        model=f"{OBJECT}/model",
    output:
        model=directory(f"{OBJECT}/turned_model"),
    log:
        f"{OBJECT}/logs/turned_model.log",
    wildcard_constraints:
        dataset=OF_MODELS,
    resources:
        **needs(2000, 5),
    message:
        "Turning {wildcards.object} over for its second pass"
    shell:
        "python -m zeroshop_steps.synthetic --method turned_model --model {input.model} --out {output.model} > {log} 2>&1"


rule blender_environment:
    input:
        requirements=BLENDER_REQUIREMENTS,
    output:
        record="resources/envs/blenderproc.json",
    log:
        "resources/envs/blenderproc.log",
    conda:
        "../envs/blenderproc.yaml"
    resources:
        **needs(2000, 60),
    message:
        "Setting up BlenderProc in an environment of its own"
    shell:
        "python -m zeroshop_steps.synthetic --method blender_environment --requirements {input.requirements:q}"
        " --folder resources/envs/blenderproc --out {output.record} > {log} 2>&1"


rule capture_virtual:
    input:
        model=plan.rendered_model,
        environment=RENDERER.environment or [],
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    wildcard_constraints:
        dataset=OF_MODELS,
        scene=f"(?!(?:{BOARD_SCENE}|{JOINED_SCENE})/)[^/]+",
    threads: 8
    resources:
        **needs(4000, RENDERER.runtime_min),
    params:
        size=PICTURE_SIZE,
        seed=plan.rendered_seed,
        scene=rendered_scene,
        method=settings["capture"]["renderer"],
        options=plan.renderer_options,
        environment=given("environment"),
    message:
        "Rendering the views of {wildcards.object} in scene {wildcards.scene}"
    shell:
        "python -m zeroshop_steps.synthetic --method {params.method} --model {input.model}/model.ply --scene {params.scene}"
        " {params.size} --seed {params.seed} --threads {threads} {params.options} {params.environment} --out {output.capture}"
        " > {log} 2>&1"


# By rule: the folder, what the photos show, and what it says.
BOARD_PHOTOS = {
    "capture_with_board": (f"{BOARD_SCENE}/capture", "object", "Rendering the views of {wildcards.object} beside a printed board"),
    "capture_empty_scene": ("su_h/empty_scene", "empty", "Rendering the empty scene of {wildcards.object} with a printed board"),
}
for name, (folder, view, says) in BOARD_PHOTOS.items():

    rule:
        name:
            name
        input:
            model=f"{OBJECT}/model",
        output:
            photos=directory(f"{OBJECT}/{folder}"),
        log:
            f"{OBJECT}/{Path(folder).parent}/logs/{Path(folder).name}.log",
        wildcard_constraints:
            dataset=OF_MODELS,
        threads: 8
        resources:
            **needs(4000, 10),
        params:
            view=view,
            size=PICTURE_SIZE,
            seed=settings["seed"],
        message:
            says
        shell:
            "python -m zeroshop_steps.synthetic --method board_scene --view {params.view} --model {input.model}/model.ply {params.size}"
            " --seed {params.seed} --threads {threads} --out {output} > {log} 2>&1"


# By rule: the folder, the model, a seed, which means another table, and what it says.
FILMS = {
    "film": ("film", "model", settings["seed"], "Filming {wildcards.object}"),
    "turned_film": ("film_2", "turned_model", settings["seed"] + 1, "Filming {wildcards.object} turned over"),
}
for name, (film, model, seed, says) in FILMS.items():

    rule:
        name:
            name
        input:
            model=plan.filmed(model),
        output:
            film=f"{OBJECT}/{film}/film.mp4",
            empty_scene=directory(f"{OBJECT}/{film}/empty_scene"),
            truth=directory(f"{OBJECT}/{film}/truth"),
        log:
            f"{OBJECT}/logs/{film}.log",
        wildcard_constraints:
            dataset=plan.of_kinds("films"),
        threads: 8
        resources:
            **needs(4000, 20),
        params:
            options=plan.film_options,
            seed=seed,
            folder=subpath(output.film, parent=True),
        message:
            says
        shell:
            "python -m zeroshop_steps.synthetic --method film --model {input.model}/model.ply {params.options}"
            " --seed {params.seed} --threads {threads} --out {params.folder} > {log} 2>&1"
