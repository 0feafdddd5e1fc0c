"""Assets: the chosen mesh as a body for robots and simulators, and its pictures with cameras for other tools.

results/DATASET/OBJECT/NVS.body/                          visual mesh, convex parts, mass and inertia: what the files below refer to
results/DATASET/OBJECT/NVS.{urdf,mjcf.xml,usda,usdz}      the body for each simulator
results/DATASET/OBJECT/NVS.{foundationpose,nerfstudio,colmap}/
"""


def mass_options(
    wildcards,
):
    """The object's mass, from its row or the config, or the usual density."""
    options = config["assets"]
    row = PHOTOS.get((wildcards.dataset, wildcards.object), {})
    mass_kg = row.get("mass_kg") or options["masses_kg"].get(wildcards.dataset, {}).get(wildcards.object)
    names = ("friction", "concavity", "most_parts", "unknown_scale")
    usual = {"mass_kg": mass_kg} if mass_kg else {name: options[name] for name in ("density_kg_m3", "density_factor")}
    return step_options({**usual, **{name: options[name] for name in names}, "seed": config["seed"]})


def chosen_cameras(
    wildcards,
):
    """The registered photos behind the chosen mesh."""
    return f"{Path(chosen_cell(wildcards)).parent}/cameras"


localrules:
    urdf,
    mjcf,


rule body:
    input:
        mesh=f"{OBJECT}/{{nvs}}.ply",
        texture=f"{OBJECT}/{{nvs}}.png",
        facts=f"{OBJECT}/{{nvs}}.json",
    output:
        body=directory(f"{OBJECT}/{{nvs}}.body"),
    log:
        f"{OBJECT}/logs/body.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/body.{{nvs}}.tsv"
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(10),
    params:
        options=mass_options,
    message:
        "Making a rigid body of {wildcards.object}: mass, inertia and convex parts"
    shell:
        "python -m zeroshop_steps.assets --method body --mesh {input.mesh} --name {wildcards.object} {params.options}"
        " --out {output.body} > {log} 2>&1"


rule urdf:
    input:
        body=f"{OBJECT}/{{nvs}}.body",
    output:
        urdf=f"{OBJECT}/{{nvs}}.urdf",
    log:
        f"{OBJECT}/logs/urdf.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/urdf.{{nvs}}.tsv"
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    params:
        options=step_options({"package": config["assets"]["package"]}),
    message:
        "Writing {output.urdf}"
    shell:
        "python -m zeroshop_steps.assets --method urdf --body {input.body} {params.options} --out {output.urdf} > {log} 2>&1"


rule mjcf:
    input:
        body=f"{OBJECT}/{{nvs}}.body",
    output:
        mjcf=f"{OBJECT}/{{nvs}}.mjcf.xml",
    log:
        f"{OBJECT}/logs/mjcf.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/mjcf.{{nvs}}.tsv"
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Writing {output.mjcf}"
    shell:
        "python -m zeroshop_steps.assets --method mjcf --body {input.body} --out {output.mjcf} > {log} 2>&1"


rule usd:
    input:
        body=f"{OBJECT}/{{nvs}}.body",
    output:
        usd=f"{OBJECT}/{{nvs}}.{{usd}}",
    log:
        f"{OBJECT}/logs/{{usd}}.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/{{usd}}.{{nvs}}.tsv"
    wildcard_constraints:
        usd="usda|usdz",
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        options=step_options({"date": config["assets"]["date"]}),
    message:
        "Writing {output.usd}"
    shell:
        "python -m zeroshop_steps.assets --method usd --body {input.body} {params.options} --out {output.usd} > {log} 2>&1"


rule foundationpose:
    input:
        mesh=f"{OBJECT}/{{nvs}}.ply",
        texture=f"{OBJECT}/{{nvs}}.png",
        facts=f"{OBJECT}/{{nvs}}.json",
    output:
        folder=directory(f"{OBJECT}/{{nvs}}.foundationpose"),
    log:
        f"{OBJECT}/logs/foundationpose.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/foundationpose.{{nvs}}.tsv"
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        options=step_options({"unknown_scale": config["assets"]["unknown_scale"]}),
    message:
        "Writing the mesh of {wildcards.object} as FoundationPose reads it"
    shell:
        "python -m zeroshop_steps.assets --method foundationpose --mesh {input.mesh} {params.options} --out {output.folder} > {log} 2>&1"


rule photo_export:
    input:
        mesh=f"{OBJECT}/{{nvs}}.ply",
        facts=f"{OBJECT}/{{nvs}}.json",
        cameras=chosen_cameras,
    output:
        folder=directory(f"{OBJECT}/{{nvs}}.{{layout}}"),
    log:
        f"{OBJECT}/logs/{{layout}}.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/{{layout}}.{{nvs}}.tsv"
    wildcard_constraints:
        layout="nerfstudio|colmap",
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        options=step_options({"unknown_scale": config["assets"]["unknown_scale"]}),
    message:
        "Writing photos, masks and cameras of {wildcards.object} for {wildcards.layout}"
    shell:
        "python -m zeroshop_steps.assets --method {wildcards.layout} --mesh {input.mesh} --cameras {input.cameras} {params.options}"
        " --out {output.folder} > {log} 2>&1"
