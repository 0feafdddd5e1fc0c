"""Synthetic: models whose true shape is known, and pictures rendered of them; films.smk has films.

results/DATASET/OBJECT/model           a shop product made by code, or one of BOP's models
results/DATASET/OBJECT/SCENE/capture   rendered views of it (su_l, su_h, se; su_b with a printed board), with true cameras
"""

# With a printed board beside the object: for measuring how well a height is found (height.smk), in no table of meshes.
BOARD_SCENE = "su_b"
# The second pass of an object, turned over on a textured ground, and both passes joined (join.smk): in no table of meshes.
TURNED_SCENE, JOINED_SCENE = "su_h_2", "su_f"
# What BlenderProc's environment consists of.
BLENDER_REQUIREMENTS = os.path.relpath(PROJECT / "workflow/envs/blenderproc.txt")


def check_virtual_scene(
    wildcards,
):
    """Raise an error that lists the scenes where a path of a virtual dataset names an unknown one."""
    require_known("scene of a virtual dataset", wildcards.scene, [*VIRTUAL_SCENES, TURNED_SCENE, JOINED_SCENE], "")


def checked_object(
    wildcards,
):
    """The object in a path, or an error that lists the objects of its dataset."""
    check_object(wildcards)
    return wildcards.object


def models_option(
    wildcards,
):
    """The option that names a local folder of BOP models, or the checksum of the archive to download, if the config does."""
    dataset = config["datasets"][wildcards.dataset]
    folder = dataset["models_folder"]
    if folder:
        return step_options({"models": shlex.quote(os.path.relpath(ROOT / folder))})
    return step_options({"models_sha256": dataset.get("models_sha256")})


def renderer_of(
    options,
):
    """The renderer that a part of the config names."""
    return methods.RENDERERS[options["renderer"]]


def environment_of(
    options,
):
    """An input function: the environment that the renderer in a part of the config needs, if it needs one."""
    environment = renderer_of(options).environment
    return lambda wildcards: [environment] if environment else []


def environment_option(
    wildcards,
    input,
):
    """The option that names this environment."""
    return step_options({"environment": str(input.environment) or None})


def renderer_options(
    wildcards,
):
    """The options of captures beside their size: the cameras and lights, and what not every renderer has."""
    capture = config["capture"]
    options = {key: capture[key] for key in ("views_per_ring", "least_height_sizes", "light_strengths")}
    options |= {"elevations_deg": capture["elevations_deg"].get(rendered_scene(wildcards))}
    options |= {"samples": capture["samples"] if renderer_of(capture).samples else None}
    return step_options(options)


def rendered_model(
    wildcards,
):
    """The model that is rendered in a scene, as it stands there."""
    check_virtual_scene(wildcards)
    return f"{OBJECT}/{'turned_model' if wildcards.scene == TURNED_SCENE else 'model'}".format(**wildcards)


def rendered_scene(
    wildcards,
):
    """The scene that the renderer knows: the second pass lies on the same kind of ground as the first."""
    return "su_h" if wildcards.scene == TURNED_SCENE else wildcards.scene


def rendered_seed(
    wildcards,
):
    """The seed of its ground and noise: in the second pass, the object lies on another print."""
    return config["seed"] + (wildcards.scene == TURNED_SCENE)


rule demo_model:
    output:
        model=directory(f"{OBJECT}/model"),
    log:
        f"{OBJECT}/logs/model.log",
    benchmark:
        f"{OBJECT}/benchmarks/model.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo"),
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(5),
    params:
        object=checked_object,
    message:
        "Making the demo object {wildcards.object}"
    shell:
        "python -m zeroshop_steps.synthetic --method demo_objects --object {params.object} --out {output.model} > {log} 2>&1"


rule bop_model:
    output:
        model=directory(f"{OBJECT}/model"),
    log:
        f"{OBJECT}/logs/model.log",
    benchmark:
        f"{OBJECT}/benchmarks/model.tsv"
    wildcard_constraints:
        dataset=datasets_of("bop"),
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(60),
    params:
        object=checked_object,
        models=models_option,
    message:
        "Fetching the model of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.synthetic --method bop_models --dataset {wildcards.dataset} --object {params.object}"
        " {params.models} --out {output.model} > {log} 2>&1"


rule turned_model:
    input:
        model=f"{OBJECT}/model",
    output:
        model=directory(f"{OBJECT}/turned_model"),
    log:
        f"{OBJECT}/logs/turned_model.log",
    benchmark:
        f"{OBJECT}/benchmarks/turned_model.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(5),
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
    benchmark:
        "resources/envs/blenderproc.tsv"
    conda:
        "../envs/blenderproc.yaml"
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(60),
    message:
        "Setting up BlenderProc in an environment of its own"
    shell:
        "python -m zeroshop_steps.synthetic --method blender_environment --requirements {input.requirements:q}"
        " --folder resources/envs/blenderproc --out {output.record} > {log} 2>&1"


rule capture_virtual:
    input:
        model=rendered_model,
        environment=environment_of(config["capture"]),
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    benchmark:
        f"{SCENE}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
        scene=f"(?!(?:{BOARD_SCENE}|{JOINED_SCENE})/)[^/]+",
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(renderer_of(config["capture"]).runtime_min),
    params:
        width_px=config["capture"]["image_width_px"],
        height_px=config["capture"]["image_height_px"],
        seed=rendered_seed,
        scene=rendered_scene,
        method=config["capture"]["renderer"],
        options=renderer_options,
        environment=environment_option,
    message:
        "Rendering the views of {wildcards.object} in scene {wildcards.scene}"
    shell:
        "python -m zeroshop_steps.synthetic --method {params.method} --model {input.model}/model.ply --scene {params.scene}"
        " --width {params.width_px} --height {params.height_px} --seed {params.seed} --threads {threads} {params.options}"
        " {params.environment} --out {output.capture} > {log} 2>&1"


rule capture_with_board:
    input:
        model=f"{OBJECT}/model",
    output:
        capture=directory(f"{OBJECT}/{BOARD_SCENE}/capture"),
    log:
        f"{OBJECT}/{BOARD_SCENE}/logs/capture.log",
    benchmark:
        f"{OBJECT}/{BOARD_SCENE}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
    threads: 8
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(10),
    params:
        view="object",
        width_px=config["capture"]["image_width_px"],
        height_px=config["capture"]["image_height_px"],
        seed=config["seed"],
    message:
        "Rendering the views of {wildcards.object} beside a printed board"
    shell:
        "python -m zeroshop_steps.synthetic --method board_scene --view {params.view} --model {input.model}/model.ply"
        " --width {params.width_px} --height {params.height_px} --seed {params.seed} --threads {threads} --out {output} > {log} 2>&1"


use rule capture_with_board as capture_empty_scene with:
    output:
        photos=directory(f"{OBJECT}/su_h/empty_scene"),
    log:
        f"{OBJECT}/su_h/logs/empty_scene.log",
    benchmark:
        f"{OBJECT}/su_h/benchmarks/empty_scene.tsv"
    params:
        view="empty",
    message:
        "Rendering the empty scene of {wildcards.object} with a printed board"
