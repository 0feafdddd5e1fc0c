"""Join: the passes of an object that was turned over in between become one set of pictures and cameras.

results/DATASET/OBJECT/su_f/REGISTRATION/cameras           rendered: su_h, and su_h_2, for which the model was turned over
results/DATASET/OBJECT/video_joined/REGISTRATION/cameras   photos: the columns images, images_2 and images_3 of objects.tsv
"""


def passes_of(
    wildcards,
):
    """The scenes of an object's passes, the first first."""
    check_object(wildcards)
    if is_virtual(wildcards.dataset):
        return ["su_h", TURNED_SCENE]
    scenes = later_passes(wildcards)
    if not scenes:
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object} has one pass only; name pictures of the object turned over in"
            " the column images_2"
        )
    return [WHOLE_SCENE, *scenes]


def chosen_run(
    wildcards,
):
    """The scene and registration that the config chooses for an object; of one with several passes, the joined scene.

    A capture that brings its cameras is registered by these.
    """
    if is_virtual(wildcards.dataset):
        return config["chosen"]["virtual"]
    chosen = config["chosen"]["photos"]
    if photos_of(wildcards)["cameras"]:
        return {"scene": WHOLE_SCENE, "registration": methods.BY_GIVEN_CAMERAS}
    return {**chosen, "scene": JOINED_PHOTOS} if chosen["scene"] == WHOLE_SCENE and later_passes(wildcards) else chosen


def of_passes(
    path,
):
    """An input function: this file or folder of every pass; `path` begins with its scene."""
    return lambda wildcards: [f"{OBJECT}/{scene}/{path}".format(**wildcards) for scene in passes_of(wildcards)]


def turned_models_of(
    wildcards,
):
    """The model as it was turned for the second pass, where it is known."""
    if is_filmed(wildcards.dataset):
        return [filmed_turned_model(wildcards)]
    return [f"{OBJECT}/turned_model".format(**wildcards)] if is_virtual(wildcards.dataset) else []


def film_truths_of(
    wildcards,
):
    """The truth of both films of an object that was filmed twice."""
    return [f"{OBJECT}/{film}/truth".format(**wildcards) for film in ("film", "film_2")] if is_filmed(wildcards.dataset) else []


rule join_captures:
    input:
        captures=of_passes("capture"),
        turned=turned_models_of,
        film_truths=film_truths_of,
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    benchmark:
        f"{SCENE}/benchmarks/capture.tsv"
    wildcard_constraints:
        scene=f"{JOINED_SCENE}|{JOINED_PHOTOS}",
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(10),
    params:
        truth=lambda wildcards, input: step_options({"turned": list(input.turned) or None, "film_truths": list(input.film_truths) or None}),
    message:
        "Putting the pictures of all passes of {wildcards.object} side by side"
    shell:
        "python -m zeroshop_steps.join --method captures --captures {input.captures} {params.truth} --scene {wildcards.scene}"
        " --out {output.capture} > {log} 2>&1"


rule join_passes:
    input:
        cameras=of_passes("{registration}/cameras"),
    output:
        cameras=directory(f"{RUN}/cameras"),
    log:
        f"{RUN}/logs/join.log",
    benchmark:
        f"{RUN}/benchmarks/join.tsv"
    wildcard_constraints:
        scene=f"{JOINED_SCENE}|{JOINED_PHOTOS}",
    threads: 2
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(30),
    params:
        options=step_options({"weights": config["register"]["aliked"]["weights"], "seed": config["seed"]}),
        weights=weights_stamp("register", "aliked", methods.REGISTRATIONS["aliked"]),
    message:
        "Joining the passes of {wildcards.object}, {wildcards.registration}"
    shell:
        "python -m zeroshop_steps.join --method passes --cameras {input.cameras} {params.options} --threads {threads}"
        " --out {output.cameras} --record-failure {output}/ > {log} 2>&1"
