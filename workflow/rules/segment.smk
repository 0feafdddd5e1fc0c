"""Segment: photos with masks of the object, given or found, without those whose mask is bad.

Scene video is registered as a whole and masked then; video_segmented is masked first and registered by the object alone.
"""


rule capture_object:
    input:
        pictures=plan.pictures_with_masks,
        capture=f"{OBJECT}/{WHOLE_SCENE}/capture",
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    wildcard_constraints:
        dataset=OF_PHOTOS,
        scene=OBJECT_SCENE,
    threads: 2
    resources:
        **needs_of("segment", plan.masks, runtime=60),
    params:
        options=plan.object_options,
        weights=plan.segmentation_weights,
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
    wildcard_constraints:
        dataset=OF_PHOTOS,
        scene=WHOLE_SCENE,
    threads: 2
    resources:
        **needs(4000, 30),
    params:
        options=step_options({"seed": settings["seed"]}),
    message:
        "Listing the objects in the photos of {wildcards.object}"
    shell:
        "python -m zeroshop_steps.segment --method list_objects --scene {input.scene} {params.options} --out {output} > {log} 2>&1"


rule segment:
    input:
        scene=f"{RUN}/scene",
        capture=f"{SCENE}/capture",
        objects=plan.of_owner(f"{RUN}/objects"),
    output:
        cameras=directory(f"{RUN}/cameras"),
    log:
        f"{RUN}/logs/segment.log",
    wildcard_constraints:
        dataset=OF_PHOTOS,
        scene=f"(?!{JOINED_PHOTOS}/)[^/]+",
    threads: 2
    resources:
        **needs_of("segment", plan.masks, runtime=60),
    params:
        method=plan.segmentation,
        options=plan.segmentation_options,
        weights=plan.segmentation_weights,
    message:
        "Masking {wildcards.object} in its photos ({params.method})"
    shell:
        "python -m zeroshop_steps.segment --method {params.method} --scene {input.scene} {params.options}"
        " --rejected {log}.png --out {output} --record-failure {output}/"
        f"{AND_REFUSALS}"
        " > {log} 2>&1"
