"""Surface: train a scene representation on the registered images, then take a raw mesh from it.

Stereo comes first, once for all methods of a registration that read it; the option `initialization: sparse` does without. The rules of a
method follow from what its file declares (src/zeroshop_steps/methods.py): one that makes the raw mesh at once, or two, with its trained
model between them.
"""

import dataclasses


rule stereo:
    input:
        cameras=f"{RUN}/cameras",
        depth=plan.depth_files,
        capture=plan.depth_capture,
    output:
        seeds=f"{RUN}/stereo/seeds.npz",
        summary=f"{RUN}/stereo/stereo.json",
    log:
        f"{RUN}/stereo/logs/stereo.log",
    threads: 8
    resources:
        # 60 images of a megapixel, with masks and contrast, take 1 GB of a GPU, beside what CUDA itself takes.
        **needs(3000, 30, 2000 if settings["stereo"]["device"] != "cpu" else 0),
    params:
        options=plan.stereo_options,
        folder=subpath(output.seeds, parent=True),
    message:
        "Looking for confirmed depths of {wildcards.object}, scene {wildcards.scene}; follow it in {log}"
    shell:
        "python -m zeroshop_steps.surface --method stereo --cameras {input.cameras} --out {params.folder}"
        " {params.options} --threads {threads} --record-failure {output} > {log} 2>&1"


# A method that can do without cameras is run in both ways.
ways = list(plan.surfaces.values())
ways += [
    dataclasses.replace(method, registration=False, rules=(f"train_without_cameras_{method.name}",))
    for method in ways
    if method.cameras_optional
]

for method in ways:
    folder, section = f"{RUN}/{method.name}", plan.surface_section(method, 0)
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
            **plan.surface_inputs(method),
        output:
            made,
        log:
            f"{folder}/logs/{logs[0]}.log",
        wildcard_constraints:
            registration=(methods.WITHOUT_CAMERAS if not method.registration else WITH_CAMERAS if method.cameras_optional else "[^/]+"),
        # On a GPU, two cores feed it, and the others are left for what goes on beside it.
        threads: min(method.threads, 2) if section.get("device") == "cuda" else method.threads
        resources:
            **needs(method.mem_mb, method.runtime_min, method.gpu_mem_mb(section)),
        params:
            method=Path(method.step).suffix[1:],
            inputs=given(),
            out=str(Path(made[0]).parent) if method.model else made[0],
            options=plan.training_options(method),
            height=plan.height_option if method.cameras_optional else "",
            resume="--resume" if method.model else "",
            seed=settings["seed"],
            weights=plan.weights_stamp("nvs", method),
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
            resources:
                **needs(4000, 15),
            params:
                method=method.mesh,
                options=step_options(plan.surface_section(method, 1)),
            message:
                f"Taking the surface of {{wildcards.object}}, scene {{wildcards.scene}}, from {method.name}"
            shell:
                "python -m zeroshop_steps.surface --method {params.method} --model {input.model} --cameras {input.cameras}"
                " {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"
