"""Register: cameras and sparse points of a capture, beside its undistorted images and masks.

A registration that fails is a result too: its record says so and why. The steps that would build on it pass it on, while a table goes
on with its other cells (tables.smk).
"""

# By rule: the datasets, the scene that is not registered but joined (join.smk), the folder, and what it says.
REGISTERED = {
    "register": (OF_MODELS, JOINED_SCENE, "cameras", "Registering the images of {wildcards.object}, scene {wildcards.scene}, with"),
    "register_photos": (OF_PHOTOS, JOINED_PHOTOS, "scene", "Registering the photos of {wildcards.object} with"),
}
for name, (datasets, joined, folder, says) in REGISTERED.items():

    rule:
        name:
            name
        input:
            capture=plan.capture_of,
        output:
            scene=directory(f"{RUN}/{folder}"),
        log:
            f"{RUN}/logs/register.log",
        wildcard_constraints:
            dataset=datasets,
            scene=f"(?!{joined}/)[^/]+",
        threads: 8
        resources:
            **needs_of("register", plan.registration),
        params:
            # The method that the command runs: of a preset, the one that it belongs to.
            method=lambda wildcards: Path(plan.registration(wildcards).step).suffix[1:],
            options=plan.registration_options,
            scene=plan.registered_scene,
            weights=plan.registration_weights,
        message:
            f"{says} {{wildcards.registration}}"
        shell:
            "python -m zeroshop_steps.register --method {params.method} --capture {input.capture}"
            " --scene {params.scene} {params.options} --threads {threads} --out {output}"
            " --record-failure {output}/"
            f"{AND_REFUSALS}"
            " > {log} 2>&1"


ruleorder: share_scene > register_photos
