"""What the rules of captures and masks take: the rows of the user's own photos, and how they are masked."""


def rendered_model(wildcards):
    """The model that is rendered in a scene."""
    check_virtual_scene(wildcards)
    return f"results/{wildcards.dataset}/{wildcards.object}/model"


def photos_of(wildcards):
    """The table row of the user's own capture, or the like of it for a rendered film."""
    check_object(wildcards)
    if is_filmed(wildcards.dataset):
        return film_row(wildcards)
    return PHOTOS[wildcards.dataset, wildcards.object]


def photo_place(wildcards, column="images"):
    """The folder or video in a column of objects.tsv, as seen from the working directory."""
    row = photos_of(wildcards)
    if is_filmed(wildcards.dataset):
        return row[column]
    path = Path(os.path.relpath(ROOT / row[column]))
    if not path.is_dir() and not (column == "images" and path.is_file()):
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: the {'video or ' if column == 'images' else ''}folder of its "
            f"{column}, {row[column]}, does not exist. Relative paths start at the folder of the workflow; correct the path."
        )
    return str(path)


def photo_files(column):
    """An input function: the files that a column of objects.tsv names, so that a changed photo reruns what depends on it."""

    def files(wildcards):
        place = Path(photo_place(wildcards, column))
        if place.is_file() or is_filmed(wildcards.dataset):
            return [str(place)]
        return sorted(str(path) for path in place.iterdir() if path.is_file() and not path.name.startswith("."))

    return files


def mask_files(wildcards):
    """The masks that came with the photos, if any did."""
    return photo_files("masks")(wildcards) if photos_of(wildcards)["masks"] else []


def capture_method(wildcards):
    """How the pictures of an object are taken: from a video or from a folder of photos."""
    return "photos" if Path(photo_place(wildcards)).is_dir() else "video"


def capture_options(wildcards):
    """The options of this method: how many frames of a video, or the masks of photos, if there are any."""
    masks = photos_of(wildcards)["masks"]
    if capture_method(wildcards) == "photos":
        return step_options({"masks": shlex.quote(photo_place(wildcards, "masks"))}) if masks else ""
    if masks:
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: a video has no masks; leave the masks empty, they are found"
        )
    return step_options(config["video"])


def segmentation_method(wildcards):
    """How the masks of registered photos come about: given ones, or by the method that the config chooses."""
    return "user_masks" if wildcards.scene == OBJECT_SCENE else mask_method(wildcards)


def segmentations():
    """The segmentation methods, with the networks that the config names."""
    models = config["segment"]["grounded_sam"]
    return {**methods.SEGMENTATIONS, "grounded_sam": methods.grounded_sam(models["detector"], models["tracker"])}


def mask_method(wildcards):
    """How the masks of photos come about, whenever: given by the user, or by the method that the config chooses."""
    if photos_of(wildcards)["masks"]:
        return "user_masks"
    name = config["segmentation"]
    if name == "auto":
        return next(name for name, method in segmentations().items() if not methods.lacks(method))
    return usable("segmentation", name, segmentations(), "")


def segmentation_weights(wildcards):
    """What its networks are read from."""
    name = mask_method(wildcards)
    return [] if name == "user_masks" else weights_stamp("segment", name, segmentations()[name])


def segmentation_options(wildcards):
    """The options of this method."""
    name = segmentation_method(wildcards)
    if name == "user_masks":
        return step_options({"capture": "results/{dataset}/{object}/{scene}/capture".format(**wildcards)})
    return options_of_segmentation(wildcards, name)


def options_of_segmentation(wildcards, name):
    """The options of a segmentation method."""
    if name == "user_masks":
        return ""
    options = {**config["segment"][name], "seed": config["seed"]}
    if name == "grounded_sam":
        options["prompt"] = shlex.quote(photos_of(wildcards)["prompt"] or options["prompt"])
    return step_options(options)


def pictures_with_masks(wildcards):
    """Where photos lie beside the masks by which they are registered: their capture, unless masks are only found in a registered scene."""
    scene = f"results/{wildcards.dataset}/{wildcards.object}/{WHOLE_SCENE}"
    return (
        f"{scene}/{config['chosen']['photos']['registration']}/cameras" if mask_method(wildcards) == "support_plane" else f"{scene}/capture"
    )


def network_options(wildcards):
    """The options for finding masks before the registration, where they are found then."""
    return options_of_segmentation(wildcards, "grounded_sam") if mask_method(wildcards) == "grounded_sam" else ""


def segmentation_memory_mb(wildcards, attempt):
    """What this method needs: networks more than the others."""
    return attempt * (8000 if mask_method(wildcards) == "grounded_sam" else 4000)


def segmentation_gpus(wildcards):
    """The CUDA devices that it uses where there are any: one for networks."""
    return int(mask_method(wildcards) == "grounded_sam")
