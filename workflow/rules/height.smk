"""Height: how many metres the object is high, and a unit of its registration long; how well that is known.

results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/height.json            by the method of its row in objects.tsv; rendered heights are known
results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/height_by_board.json   by a printed board, for the table that compares it with the truth
results/DATASET/OBJECT/SCENE/REGISTRATION/NVS/height_by_mast3r.json  by MASt3R, from two photos of the object and four of the empty scene
"""

# Where a row of objects.tsv names no method: with a height, and without one.
KNOWN_HEIGHT, UNKNOWN_HEIGHT = "known", "none"
HEIGHTS = {name: with_own_weights("height", name, method) for name, method in methods.HEIGHTS.items()}


def height_method(
    wildcards,
):
    """How the height of an object is measured."""
    if is_virtual(wildcards.dataset):
        return KNOWN_HEIGHT
    row = photos_of(wildcards)
    without = methods.HEIGHT_BY_GIVEN_CAMERAS if row["cameras"] else UNKNOWN_HEIGHT
    name = row["height_method"] or (without if row["height_m"] is None else KNOWN_HEIGHT)
    return usable("height method", name, HEIGHTS, "")


def height_needs(
    wildcards,
):
    """What this method needs."""
    return HEIGHTS[height_method(wildcards)]


def extra_photos(
    column,
):
    """An input function: the files in a folder of objects.tsv that only some height methods read; none where they do not."""

    def files(
        wildcards,
    ):
        if column not in height_needs(wildcards).columns or not photos_of(wildcards)[column]:
            return []
        return photo_files(column)(wildcards)

    return files


def height_options(
    wildcards,
):
    """The options of the height method."""
    method = height_needs(wildcards)
    options = dict(config["height"].get(method.name) or {})
    if not is_virtual(wildcards.dataset):
        options["height_m"] = photos_of(wildcards)["height_m"]
    if method.seed:
        options["seed"] = config["seed"]
    row = f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}"
    for column in method.required:
        if not photos_of(wildcards)[column]:
            raise WorkflowError(f"{row}: height_method {method.name} needs the folder of {column} images in the column {column}")
    if method.original_photos and capture_method(wildcards) == "video":
        raise WorkflowError(f"{row}: {method.name} images belong to photos, images names a video; export the colour images as photos, too")
    if method.original_photos and wildcards.scene == OBJECT_SCENE and mask_needs(wildcards).in_scene:
        raise WorkflowError(
            f"{wildcards.dataset} {wildcards.object}: scene {OBJECT_SCENE} is made of photos that have been undistorted to find the masks, "
            f"with which depth images are not aligned; take scene {WHOLE_SCENE}, give masks, or another segmentation"
        )
    for column in method.columns:
        if extra_photos(column)(wildcards):
            options[column] = shlex.quote(photo_place(wildcards, column))
    return step_options(options)


def empty_scene_of(
    wildcards,
):
    """The photos of the empty scene with the board, for views without it."""
    return [] if wildcards.scene == BOARD_SCENE else f"{SCENE}/empty_scene".format(**wildcards)


def empty_scene_option(
    wildcards,
    input,
):
    """The option that names them."""
    return step_options({"marker_images": f"{input.empty_scene}/images" if input.empty_scene else None})


def photos_for_mast3r(
    wildcards,
):
    """The photos of the empty scene: rendered, or of the user's row."""
    usable("height method", "mast3r", HEIGHTS, "The file is named after the method.")
    return [f"{SCENE}/empty_scene"] if is_virtual(wildcards.dataset) else photo_files("marker_images")(wildcards)


def options_for_mast3r(
    wildcards,
):
    """The options of MASt3R: its own, where the photos lie, and the height that it is compared with."""
    options = dict(config["height"]["mast3r"])
    if is_virtual(wildcards.dataset):
        return step_options({**options, "marker_images": f"{SCENE}/empty_scene/images".format(**wildcards)})
    row = photos_of(wildcards)
    return step_options({**options, "marker_images": shlex.quote(photo_place(wildcards, "marker_images")), "height_m": row["height_m"]})


rule height_by_board:
    input:
        mesh=f"{CELL}/clean.ply",
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        stereo=f"{RUN}/stereo/seeds.npz",
        empty_scene=empty_scene_of,
    output:
        height=f"{CELL}/height_by_board.json",
    log:
        f"{CELL}/logs/height_by_board.log",
    benchmark:
        f"{CELL}/benchmarks/height_by_board.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop"),
        scene=f"su_h|{BOARD_SCENE}",
    threads: 2
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        options=step_options({**config["height"]["marker"], "seed": config["seed"]}),
        photos=empty_scene_option,
    message:
        "Measuring {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}, by the printed board"
    shell:
        "python -m zeroshop_steps.height --method marker --blind --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --stereo {input.stereo} {params.photos} {params.options} --threads {threads} --out {output.height}"
        " --record-failure {output} > {log} 2>&1"


rule height_by_mast3r:
    input:
        mesh=f"{CELL}/clean.ply",
        cameras=f"{RUN}/cameras",
        capture=f"{SCENE}/capture",
        stereo=f"{RUN}/stereo/seeds.npz",
        photos=photos_for_mast3r,
    output:
        height=f"{CELL}/height_by_mast3r.json",
    log:
        f"{CELL}/logs/height_by_mast3r.log",
    benchmark:
        f"{CELL}/benchmarks/height_by_mast3r.tsv"
    wildcard_constraints:
        dataset=datasets_of("demo", "bop", "photos"),
        scene=f"su_h|{WHOLE_SCENE}",
    threads: 2
    resources:
        mem_mb=per_attempt(HEIGHTS["mast3r"].mem_mb),
        runtime=per_attempt(HEIGHTS["mast3r"].runtime_min),
        gpu=1,
        gpu_mem_mb=HEIGHTS["mast3r"].mem_mb,
    params:
        options=options_for_mast3r,
        weights=lambda wildcards: weights_stamp("height", "mast3r", HEIGHTS["mast3r"]),
    message:
        "Measuring {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}, by MASt3R"
    shell:
        "python -m zeroshop_steps.height --method mast3r --blind --mesh {input.mesh} --cameras {input.cameras} --capture {input.capture}"
        " --stereo {input.stereo} {params.options} --out {output.height} --record-failure {output}"
        f"{AND_REFUSALS}"
        " > {log} 2>&1"
