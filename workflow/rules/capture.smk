"""Capture: the user's own photos or the frames of a video, checked and copied; a row of config/objects.tsv says where they lie."""


rule capture_photos:
    input:
        images=plan.image_files,
        masks=plan.files("masks"),
        cameras=plan.files("cameras"),
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    wildcard_constraints:
        dataset=OF_PHOTOS,
        scene="|".join([WHOLE_SCENE, *LATER_PASSES]),
    resources:
        **needs(2000, 20),
    params:
        images=plan.images,
        method=plan.capture_method,
        odd_names=plan.odd_names,
        options=plan.capture_options,
    message:
        "Taking the pictures of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.capture --method {params.method} --images {params.images:q} {params.options}"
        " --out {output.capture} > {log} 2>&1"


# Several objects in the same photos. By rule: the folder that they share, its log and what it says.
SHARED = {
    "share_capture": (f"{SCENE}/capture", f"{SCENE}/logs/capture.log", "Taking the photos that show {wildcards.object}, too"),
    "share_scene": (f"{RUN}/scene", f"{RUN}/logs/register.log", "Taking the cameras that see {wildcards.object}, too"),
}
for name, (folder, words, says) in SHARED.items():

    rule:
        name:
            name
        input:
            folder=plan.of_owner(folder),
        output:
            folder=directory(folder),
        log:
            words,
        wildcard_constraints:
            dataset=plan.of_kinds("photos"),
            object="|".join(plan.shared) or NOTHING,
            scene=WHOLE_SCENE,
        resources:
            **needs(500, 5),
        message:
            says
        shell:
            "python -m zeroshop_steps.capture --method share --folder {input} --out {output} > {log} 2>&1"


ruleorder: share_capture > capture_photos
