"""Surface: train a scene representation on the registered images, then take a raw mesh from it.

Stereo comes first, once for all methods of a registration that read it; the option `initialization: sparse` does without. The rules of a method follow from what its file declares
(src/zeroshop_steps/methods.py): one that makes the raw mesh at once, or two, with its trained model between them.
"""

import dataclasses
import itertools

SURFACES = {name: with_own_weights("nvs", name, method) for name, method in methods.SURFACES.items()}


def surface_method(
    name,
):
    """A surface method as the config has it: one that starts from sparse points reads no stereo. None for an unknown name."""
    method = SURFACES.get(name)
    sparse = method is not None and method.options and surface_section(method, 0).get("initialization") == "sparse"
    return dataclasses.replace(method, stereo=False) if sparse else method


def surface_section(
    method,
    step,
):
    """The options that the config has for a step of a surface method."""
    options = config["nvs"].get(method.name) or {}
    return options.get(method.options[step], {}) if method.options else options


def training_options(
    method,
):
    """An input function: the options of its first step; of a capture without a ground, with the iterations that those have."""
    section = dict(surface_section(method, 0))
    of_objects = section.pop("object_iterations", None)

    def options(
        wildcards,
    ):
        alone = wildcards.scene in ("se", OBJECT_SCENE) and of_objects
        return step_options({**section, "iterations": of_objects} if alone else section)

    return options


def surface_inputs(
    method,
):
    """What a surface method reads: cameras, or the capture alone, and confirmed depths."""
    cameras = {"cameras": f"{RUN}/cameras"} if method.registration else {"capture": f"{SCENE}/capture"}
    return cameras | ({"stereo": f"{RUN}/stereo/seeds.npz"} if method.stereo else {})


def confirmed_depths(
    wildcards,
):
    """The depths that stereo confirmed, if the surface method of the path reads them; then later steps read them, too."""
    method = surface_method(wildcards.nvs)
    return f"{RUN}/stereo/seeds.npz".format(**wildcards) if method is None or method.stereo else []


rule stereo:
    input:
        cameras=f"{RUN}/cameras",
    output:
        seeds=f"{RUN}/stereo/seeds.npz",
        summary=f"{RUN}/stereo/stereo.json",
    log:
        f"{RUN}/stereo/logs/stereo.log",
    benchmark:
        f"{RUN}/stereo/benchmarks/stereo.tsv"
    threads: 8
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(30),
        gpu=int(config["stereo"]["device"] != "cpu"),
        # 60 images of a megapixel, with masks and contrast, take 1 GB, beside what CUDA itself takes.
        gpu_mem_mb=2000 if config["stereo"]["device"] != "cpu" else 0,
    params:
        options=step_options(config["stereo"]),
        seed=config["seed"],
        folder=subpath(output.seeds, parent=True),
    message:
        "Looking for confirmed depths of {wildcards.object}, scene {wildcards.scene}; follow it in {log}"
    shell:
        "python -m zeroshop_steps.surface --method stereo --cameras {input.cameras} --out {params.folder}"
        " {params.options} --seed {params.seed} --threads {threads} --record-failure {output} > {log} 2>&1"


def ways_of(
    method,
):
    """A surface method as its rules run it: with cameras or without, or in both ways."""
    if not method.cameras_optional:
        return [method]
    return [method, dataclasses.replace(method, registration=False, rules=(f"train_without_cameras_{method.name}",))]


def height_option(
    wildcards,
):
    """The height that the user gives, for a method that has no cameras to measure it."""
    given = wildcards.registration == methods.WITHOUT_CAMERAS and not is_virtual(wildcards.dataset)
    return step_options({"height_m": photos_of(wildcards)["height_m"]} if given else {})


for method in itertools.chain(*map(ways_of, map(surface_method, SURFACES))):
    inputs = surface_inputs(method)
    folder = f"{RUN}/{method.name}"
    made = [f"{folder}/raw_mesh.ply", f"{folder}/raw_mesh.json"]
    names = method.rules or (f"train_{method.name}", f"mesh_{method.name}")
    logs = [name.removesuffix(f"_{method.name}") for name in names]
    if method.model:
        record = f"{folder}/{Path(method.model).parent}/training"
        made = [f"{folder}/{method.model}", f"{record}.csv", f"{record}.json"]

    rule:
        name:
            names[0]
        input:
            **inputs,
        output:
            made,
        log:
            f"{folder}/logs/{logs[0]}.log",
        benchmark:
            f"{folder}/benchmarks/{logs[0]}.tsv"
        wildcard_constraints:
            registration=(methods.WITHOUT_CAMERAS if not method.registration else WITH_CAMERAS if method.cameras_optional else "[^/]+"),
        # On a GPU, two cores feed it, and the others are left for what goes on beside it.
        threads: min(method.threads, 2) if surface_section(method, 0).get("device") == "cuda" else method.threads
        resources:
            mem_mb=per_attempt(method.mem_mb),
            runtime=per_attempt(method.runtime_min),
            gpu=int(method.gpu_mem_mb(surface_section(method, 0)) > 0),
            gpu_mem_mb=method.gpu_mem_mb(surface_section(method, 0)),
        params:
            method=method.step.partition(".")[2],
            inputs=inputs_as_options,
            out=str(Path(made[0]).parent) if method.model else made[0],
            options=training_options(method),
            height=height_option if method.cameras_optional else "",
            resume="--resume" if method.model else "",
            seed=config["seed"],
            weights=weights_stamp("nvs", method.name, method),
        message:
            f"Training {method.name} on {{wildcards.object}}, scene {{wildcards.scene}}; follow it in {{log}}"
        shell:
            # Snakemake reads this when the job runs, so it names nothing of the loop.
            "python -m zeroshop_steps.surface --method {params.method} {params.inputs}"
            " --out {params.out} {params.options} {params.height} --seed {params.seed} --threads {threads} {params.resume}"
            " --record-failure {output}"
            f"{AND_REFUSALS}"
            " > {log} 2>&1"

    if method.model:

        rule:
            name:
                names[1]
            input:
                cameras=f"{RUN}/cameras",
                model=f"{folder}/{method.model}",
            output:
                mesh=f"{folder}/raw_mesh.ply",
                facts=f"{folder}/raw_mesh.json",
            log:
                f"{folder}/logs/{logs[1]}.log",
            benchmark:
                f"{folder}/benchmarks/{logs[1]}.tsv"
            resources:
                mem_mb=per_attempt(4000),
                runtime=per_attempt(15),
            params:
                method=method.mesh,
                options=step_options(surface_section(method, 1)),
            message:
                f"Taking the surface of {{wildcards.object}}, scene {{wildcards.scene}}, from {method.name}"
            shell:
                "python -m zeroshop_steps.surface --method {params.method} --model {input.model} --cameras {input.cameras}"
                " {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"
