"""Register: cameras and sparse points of a capture, beside its undistorted images and masks.

A registration that fails is a result too: its record says so and why. The steps that would build on it pass it on, while a table goes
on with its other cells (matrix.smk).
"""


def registrations_of(
    dataset,
):
    """The registrations that make sense for a dataset: photos have no true cameras, and nothing rendered brings any of its own."""
    return {
        name: with_own_weights("register", name, method)
        for name, method in methods.REGISTRATIONS.items()
        if not (method.given_cameras if is_virtual(dataset) else method.true_cameras)
    }


def refuse_without_cameras(
    wildcards,
):
    """Raise an error for what a cell without cameras does not have."""
    raise WorkflowError(
        f"a cell of registration {methods.WITHOUT_CAMERAS} ends with its raw mesh, or with mesh.ply where that was generated: all else"
        f" needs cameras. Take one of {', '.join(registrations_of(wildcards.dataset))} in place of {methods.WITHOUT_CAMERAS}"
    )


def capture_of(
    wildcards,
):
    """The capture that a registration reads, with every part of its path checked."""
    check_object(wildcards)
    if wildcards.registration == methods.WITHOUT_CAMERAS:
        refuse_without_cameras(wildcards)
    virtual = is_virtual(wildcards.dataset)
    kind = "virtual" if virtual else "photo"
    require_known(
        f"scene of a {kind} dataset",
        wildcards.scene,
        [*VIRTUAL_SCENES, BOARD_SCENE, TURNED_SCENE, JOINED_SCENE] if virtual else [*PHOTO_SCENES, *LATER_PASSES, JOINED_PHOTOS],
        "",
    )
    usable(
        f"registration of a {kind} dataset",
        wildcards.registration,
        registrations_of(wildcards.dataset),
        "" if virtual else "Photos have no true cameras.",
    )
    return f"{SCENE}/capture".format(**wildcards)


def registration_needs(
    wildcards,
):
    """The registration that the path names. An unknown one is refused by `capture_of`."""
    return methods.REGISTRATIONS.get(wildcards.registration, next(iter(methods.REGISTRATIONS.values())))


def registration_options(
    wildcards,
):
    """The options of the registration method in the path; the true cameras need none."""
    options = config["register"].get(wildcards.registration)
    if not options:
        return ""
    needs = registration_needs(wildcards)
    weights = f"--weights {methods.WEIGHTS_FOLDER / needs.weights[0]} " if needs.preset and not options.get("weights") else ""
    return weights + step_options({**options, **network_options(registration_network(wildcards)), "seed": config["seed"]})


def registration_method(
    wildcards,
):
    """The method that the command runs: of a preset, the one that it belongs to."""
    return registration_needs(wildcards).step.partition(".")[2]


def registration_network(
    wildcards,
):
    """The salient-object network by which the registration masks photos; None where it uses none, or the photos have masks."""
    if not registration_needs(wildcards).saliency or is_virtual(wildcards.dataset) or wildcards.scene == OBJECT_SCENE:
        return None
    return None if photos_of(wildcards)["masks"] else salient_network()


def registration_weights(
    wildcards,
):
    """The files that the registration reads its networks from."""
    needs = registration_needs(wildcards)
    return weights_stamp("register", wildcards.registration, needs, registration_network(wildcards))


def registered_scene(
    wildcards,
):
    """The scene as a registration knows it: a later pass lies on a ground as the first one does."""
    return "su_h" if wildcards.scene == TURNED_SCENE else WHOLE_SCENE if wildcards.scene in LATER_PASSES else wildcards.scene


rule register:
    input:
        capture=capture_of,
    output:
        cameras=directory(f"{RUN}/cameras"),
    log:
        f"{RUN}/logs/register.log",
    benchmark:
        f"{RUN}/benchmarks/register.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
        scene=f"(?!{JOINED_SCENE}/)[^/]+",
    threads: 8
    resources:
        mem_mb=lambda wildcards, attempt: registration_needs(wildcards).mem_mb * attempt,
        runtime=lambda wildcards, attempt: registration_needs(wildcards).runtime_min * attempt,
        gpu=gpu_of("register", registration_needs),
        gpu_mem_mb=gpu_mem_of("register", registration_needs),
    params:
        method=registration_method,
        options=registration_options,
        scene=registered_scene,
        weights=registration_weights,
    message:
        "Registering the images of {wildcards.object}, scene {wildcards.scene}, with {wildcards.registration}"
    shell:
        "python -m zeroshop_steps.register --method {params.method} --capture {input.capture}"
        " --scene {params.scene} {params.options} --threads {threads} --out {output} --record-failure {output}/"
        f"{AND_REFUSALS}"
        " > {log} 2>&1"


use rule register as register_photos with:
    output:
        scene=directory(f"{RUN}/scene"),
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
        scene=f"(?!{JOINED_PHOTOS}/)[^/]+",
    message:
        "Registering the photos of {wildcards.object} with {wildcards.registration}"


use rule share_capture as share_scene with:
    input:
        folder=lambda wildcards: f"{RESULTS}/{wildcards.dataset}/{scene_owner(wildcards)}/{wildcards.scene}/{wildcards.registration}/scene",
    output:
        folder=directory(f"{RUN}/scene"),
    log:
        f"{RUN}/logs/register.log",
    benchmark:
        f"{RUN}/benchmarks/register.tsv"
    message:
        "Taking the cameras that see {wildcards.object}, too"


ruleorder: share_scene > register_photos
