"""Segment: photos with masks of the object, given or found, without those whose mask is bad.

Scene video is registered as a whole and masked then; video_segmented is masked first and registered by the object alone.
"""

# The segmentation methods, with the networks that the config names, and the one for masks that came with the photos.
SEGMENTATIONS = {name: with_own_weights("segment", name, method) for name, method in methods.SEGMENTATIONS.items()}
[GIVEN_MASKS] = [name for name, method in methods.find_methods("segment").items() if method.given]


def mask_method(
    wildcards,
):
    """The method that gives photos their masks, before or after registration: the user's masks, or the one that the config chooses."""
    if photos_of(wildcards)["masks"]:
        return GIVEN_MASKS
    name = config["segmentation"]
    if name == "auto":
        there = [name for name, method in SEGMENTATIONS.items() if not methods.lacks(method)]
        return next(name for name in there if not SEGMENTATIONS[name].saliency or salient_network())
    return usable("segmentation", name, SEGMENTATIONS, "")


def mask_network(
    name,
):
    """The salient-object network of a segmentation method; None where it needs none."""
    return salient_network(needed=True) if SEGMENTATIONS[name].saliency else None


def mask_needs(
    wildcards,
):
    """What that method needs."""
    return methods.find_methods("segment")[mask_method(wildcards)]


def segmentation_method(
    wildcards,
):
    """The method that gives registered photos their masks: the user's masks, or the one that the config chooses."""
    return GIVEN_MASKS if wildcards.scene == OBJECT_SCENE else mask_method(wildcards)


def segmentation_options(
    wildcards,
):
    """The options of this method."""
    name = segmentation_method(wildcards)
    if name == GIVEN_MASKS:
        return step_options({"capture": f"{SCENE}/capture".format(**wildcards)})
    chosen = [{"objects": f"{listed}/objects.json", "number": photos_of(wildcards)["number"]} for listed in listed_objects(wildcards)]
    return " ".join([options_of_segmentation(wildcards, name), *map(step_options, chosen)])


def listed_objects(
    wildcards,
):
    """The list of all objects in a scene that belongs to another object; empty where there is none."""
    owner = scene_owner(wildcards)
    return [f"{RESULTS}/{wildcards.dataset}/{owner}/{wildcards.scene}/{wildcards.registration}/objects"] if owner else []


def options_of_segmentation(
    wildcards,
    name,
):
    """The options of a segmentation method."""
    options = {**(config["segment"].get(name) or {}), **network_options(mask_network(name)), "seed": config["seed"]}
    if SEGMENTATIONS[name].prompt:
        options["prompt"] = shlex.quote(photos_of(wildcards)["prompt"] or options["prompt"])
    return step_options(options)


def segmentation_weights(
    wildcards,
):
    """The files that this method reads its networks from."""
    name = mask_method(wildcards)
    return [] if name == GIVEN_MASKS else weights_stamp("segment", name, SEGMENTATIONS[name], mask_network(name))


def pictures_with_masks(
    wildcards,
):
    """The folder of photos and the masks to register them by: the capture, or a registered scene if masks are found only there."""
    scene = f"{RESULTS}/{wildcards.dataset}/{wildcards.object}/{WHOLE_SCENE}"
    registration = config["chosen"]["photos"]["registration"]
    return f"{scene}/{registration}/cameras" if mask_needs(wildcards).in_scene else f"{scene}/capture"


def object_options(
    wildcards,
):
    """The segmentation that finds masks before the registration, and its options, which come last; nothing if there are masks."""
    name, needs = mask_method(wildcards), mask_needs(wildcards)
    if needs.given or needs.in_scene:
        return ""
    return f"--segmentation {name} --options {options_of_segmentation(wildcards, name)}"


rule capture_object:
    input:
        pictures=pictures_with_masks,
        capture=f"{OBJECT}/{WHOLE_SCENE}/capture",
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    benchmark:
        f"{SCENE}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
        scene=OBJECT_SCENE,
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: attempt * mask_needs(wildcards).mem_mb,
        runtime=per_attempt(60),
        gpu=gpu_of("segment", mask_needs),
        gpu_mem_mb=gpu_mem_of("segment", mask_needs),
    params:
        options=object_options,
        weights=segmentation_weights,
    message:
        "Taking the pictures of {wildcards.object} with their masks, to register the object alone"
    shell:
        "python -m zeroshop_steps.segment --method object_capture --pictures {input.pictures} --capture {input.capture}"
        " --rejected {log}.png --out {output} --record-failure {output}/"
        f"{AND_REFUSALS}"
        " {params.options} > {log} 2>&1"


rule list_objects:
    input:
        scene=f"{RUN}/scene",
    output:
        objects=directory(f"{RUN}/objects"),
    log:
        f"{RUN}/logs/list_objects.log",
    benchmark:
        f"{RUN}/benchmarks/list_objects.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
        scene=WHOLE_SCENE,
    threads: 2
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(30),
    params:
        options=step_options({"seed": config["seed"]}),
    message:
        "Listing the objects in the photos of {wildcards.object}"
    shell:
        "python -m zeroshop_steps.segment --method list_objects --scene {input.scene} {params.options} --out {output} > {log} 2>&1"


rule segment:
    input:
        scene=f"{RUN}/scene",
        capture=f"{SCENE}/capture",
        objects=listed_objects,
    output:
        cameras=directory(f"{RUN}/cameras"),
    log:
        f"{RUN}/logs/segment.log",
    benchmark:
        f"{RUN}/benchmarks/segment.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
        scene=f"(?!{JOINED_PHOTOS}/)[^/]+",
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: attempt * mask_needs(wildcards).mem_mb,
        runtime=per_attempt(60),
        gpu=gpu_of("segment", mask_needs),
        gpu_mem_mb=gpu_mem_of("segment", mask_needs),
    params:
        method=segmentation_method,
        options=segmentation_options,
        weights=segmentation_weights,
    message:
        "Masking {wildcards.object} in its photos ({params.method})"
    shell:
        "python -m zeroshop_steps.segment --method {params.method} --scene {input.scene} {params.options}"
        " --rejected {log}.png --out {output} --record-failure {output}/"
        f"{AND_REFUSALS}"
        " > {log} 2>&1"
