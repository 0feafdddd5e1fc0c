"""What the rules of height.smk read: by which method a height is measured, with which files and options."""

import os
import shlex

from zeroshop_steps.runtime import failures


def height_method(wildcards):
    """How the height of an object is measured."""
    if is_virtual(wildcards.dataset):
        return "known"
    row = photos_of(wildcards)
    name = row["height_method"] or ("none" if row["height_m"] is None else "known")
    return usable("height method", name, {key: with_own_weights("height", key, method) for key, method in methods.HEIGHTS.items()}, "")


def height_needs(wildcards):
    """What this method needs."""
    return methods.HEIGHTS[height_method(wildcards)]


def extra_photos(column):
    """An input function: the files in a folder of objects.tsv that only some height methods read; none where they do not."""
    readers = {"marker_images": ("marker", "mast3r"), "depth": ("depth_camera",)}

    def files(wildcards):
        if height_method(wildcards) not in readers[column] or not photos_of(wildcards)[column]:
            return []
        return photo_files(column)(wildcards)

    return files


def height_options(wildcards):
    """The options of the height method."""
    name = height_method(wildcards)
    options = dict(config["height"].get(name, {}))
    if not is_virtual(wildcards.dataset):
        options["height_m"] = photos_of(wildcards)["height_m"]
    if name == "marker":
        options["seed"] = config["seed"]
    if name == "depth_camera" and not photos_of(wildcards)["depth"]:
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: height_method depth_camera needs the folder of the "
            "depth images in the column depth"
        )
    if name == "depth_camera" and capture_method(wildcards) == "video":
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: depth images belong to photos, images names a video; export "
            "the colour images as photos, too"
        )
    if name == "depth_camera" and wildcards.scene == OBJECT_SCENE and mask_method(wildcards) == "support_plane":
        raise WorkflowError(
            f"{wildcards.dataset} {wildcards.object}: scene {OBJECT_SCENE} is made of photos that have been undistorted to find the masks, "
            f"with which depth images are not aligned; take scene {WHOLE_SCENE}, give masks, or segment by grounded_sam"
        )
    for column in ("marker_images", "depth"):
        if extra_photos(column)(wildcards):
            options[column] = shlex.quote(photo_place(wildcards, column))
    return step_options(options)


def board_cells(wildcards):
    """The height of every object of a dataset by the board, beside it and in the empty scene. Failures are rows of the table."""
    virtual_dataset(wildcards.dataset)
    os.environ[failures.SWITCH] = "1"
    nvs = table_axis("nvs")[0]
    cell = "results/{}/{}/{}/{}/{}/height_by_board.json"
    registration = config["chosen"]["virtual"]["registration"]
    return [
        cell.format(wildcards.dataset, name, scene, registration, nvs)
        for name in objects_of(wildcards.dataset)
        for scene in (BOARD_SCENE, "su_h")
    ]


def empty_scene_of(wildcards):
    """The photos of the empty scene with the board, for views without it."""
    return [] if wildcards.scene == BOARD_SCENE else "results/{dataset}/{object}/{scene}/empty_scene".format(**wildcards)


def empty_scene_option(wildcards, input):
    """The option that names them."""
    return step_options({"marker_images": f"{input.empty_scene}/images" if input.empty_scene else None})
