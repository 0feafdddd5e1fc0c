"""Capture: the user's own photos or the frames of a video, checked and copied; a row of config/objects.tsv says where they lie."""

import math

from zeroshop_steps.geometry.imaging.image_files import is_text
from zeroshop_steps.runtime.errors import remedy_for

# The scenes of later passes, for which the object was turned over, and the columns that name their pictures; and all passes joined (join.smk).
LATER_PASSES = {"video_2": "images_2", "video_3": "images_3"}
JOINED_PHOTOS = "video_joined"
MOST_SHARE = 1.5  # of a row's picture_count: frames in all, with those between two that share too little
CLOCK_TOLERANCE_S = 5  # clocks of file servers differ by a second or two; a capture takes longer


def photos_of(
    wildcards,
):
    """The table row of the user's own capture; for rendered films, a row that is made up."""
    check_object(wildcards)
    if not is_filmed(wildcards.dataset):
        return PHOTOS[wildcards.dataset, wildcards.object]
    folder = f"{RESULTS}/{wildcards.dataset}/{wildcards.object}/film"
    described = config["datasets"][wildcards.dataset]
    scene = "" if described["board"] == "beside" else f"{folder}/empty_scene"
    row = {"images": f"{folder}/film.mp4", "height_method": "marker", "marker_images": scene}
    if scene and described.get("table", "print") != "print":
        row |= {"height_method": "", "marker_images": ""}  # nothing tells where photos of an empty plain table lie: unknown scale
    if film_passes(wildcards.dataset) > 1:
        row["images_2"] = f"{folder}_2/film.mp4"
    return {
        **dict.fromkeys(("masks", "prompt", "depth", "cameras", *LATER_PASSES.values()), ""),
        "height_m": None,
        "picture_count": None,
        **row,
    }


def later_passes(
    wildcards,
):
    """The scenes of an object's later passes, in their order; none where it has one pass."""
    row = photos_of(wildcards)
    scenes = [scene for scene, column in LATER_PASSES.items() if row[column]]
    if scenes and row["masks"]:
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: masks of several passes cannot be given; leave the masks"
            " empty, they are found"
        )
    if scenes and row["cameras"]:
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: cameras of several passes cannot be given; leave the cameras"
            " empty, they are estimated"
        )
    return scenes


def scene_owner(
    wildcards,
):
    """The object whose photos show this one, too; empty where it has photos of its own."""
    return "" if is_filmed(wildcards.dataset) else photos_of(wildcards)["scene_of"]


# Objects in photos of other ones, as a regular expression.
SHARED = "|".join(name for (_, name), row in PHOTOS.items() if row["scene_of"]) or "(?!)"


def pass_column(
    wildcards,
):
    """The column of objects.tsv that names the pictures of a scene."""
    return LATER_PASSES.get(wildcards.scene, "images")


def photo_place(
    wildcards,
    column="images",
):
    """The folder or video in a column of objects.tsv, as seen from the working directory."""
    row = photos_of(wildcards)
    if is_filmed(wildcards.dataset):
        return row[column]
    path = Path(os.path.relpath(ROOT / row[column]))
    if not has_plain_name(path):
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: the path of its {column}, {ascii(row[column])}, holds braces or"
            " is not UTF-8; rename the folder or the video with plain letters and digits"
        )
    pictures = column.startswith("images")
    if column == "cameras" and path.is_file():
        return str(path)
    if not row[column] or (not path.is_dir() and not (pictures and path.is_file())):
        raise WorkflowError(
            f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: the {'video or ' if pictures else ''}folder of its "
            f"{column}, {row[column]}, does not exist. Relative paths start at the folder of the workflow; correct the path."
        )
    return str(path)


def filmed_objects(
    names,
):
    """Those of these objects of `photos` whose pictures are there, and those of the empty scene, if their row names some."""
    places = {name: [PHOTOS["photos", name][column] for column in ("images", "marker_images")] for name in names}
    return [name for name, found in places.items() if found[0] and all((ROOT / place).exists() for place in found if place)]


def photo_files(
    column,
):
    """An input function: the files that a column of objects.tsv names, so that a changed photo reruns what depends on it."""

    def files(
        wildcards,
    ):
        place = Path(photo_place(wildcards, column))
        if is_filmed(wildcards.dataset):
            return [str(place)]
        found = [place] if place.is_file() else [path for path in visible_files(place) if has_plain_name(path)]
        require_past(found, f"{place}/*" if place.is_dir() else place)
        return sorted(map(str, found))

    return files


def require_past(
    files,
    words,
):
    """Raise an error where a file was changed in the future: Snakemake would discard what is made from it as older. `words` name all files."""
    ahead = [path for path in files if path.stat().st_mtime > time.time() + CLOCK_TOLERANCE_S]
    if ahead:
        changed = time.strftime("%Y-%m-%d %H:%M", time.localtime(ahead[0].stat().st_mtime))
        raise WorkflowError(
            f"{len(ahead)} of the user's files are from the future, such as {ahead[0]} ({changed}): the clock of this machine or of the"
            f" camera is wrong. Set it right, or give the files the present time: touch {words}"
        )


def visible_files(
    folder,
):
    """The files in one of the user's folders, without hidden ones."""
    try:
        return [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    except OSError as error:
        raise WorkflowError(f"the folder {folder} cannot be read: {error.strerror}. {remedy_for(error)}") from None


def has_plain_name(
    path,
):
    """Whether Snakemake can name a file: it takes braces for wildcards, and fails at names that are not UTF-8."""
    return is_text(str(path)) and not set("{}") & set(str(path))


def odd_names(
    wildcards,
):
    """Photos whose names Snakemake cannot take as inputs, with size and time: a parameter, so that changes are noticed."""
    place = Path(photo_place(wildcards, pass_column(wildcards)))
    odd = [] if place.is_file() or is_filmed(wildcards.dataset) else [path for path in visible_files(place) if not has_plain_name(path)]
    return [f"{ascii(path.name)} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in sorted(odd)]


def mask_files(
    wildcards,
):
    """The masks that came with the photos, if any did."""
    return photo_files("masks")(wildcards) if photos_of(wildcards)["masks"] else []


def camera_files(
    wildcards,
):
    """The cameras that came with the photos, if any did."""
    return photo_files("cameras")(wildcards) if photos_of(wildcards)["cameras"] else []


def capture_method(
    wildcards,
):
    """How the pictures of a pass are taken: from a video or from a folder of photos."""
    return "photos" if Path(photo_place(wildcards, pass_column(wildcards))).is_dir() else "video"


def capture_options(
    wildcards,
):
    """The options of this method: how many frames of a video, or how many photos, and their masks and cameras, if there are any."""
    row = photos_of(wildcards)
    count = row["picture_count"]
    if capture_method(wildcards) == "photos":
        given = {name: shlex.quote(photo_place(wildcards, name)) for name in ("masks", "cameras") if row[name]}
        return step_options({**given, **config["photos"], **({"most_images": count} if count else {})})
    for column in ("masks", "cameras"):
        if row[column]:
            raise WorkflowError(
                f"{config['objects_table']}: {wildcards.dataset} {wildcards.object}: a video has no {column}; leave the {column} empty,"
                " they are found"
            )
    own = {"frames": count, "most_frames": max(config["video"]["most_frames"], math.ceil(MOST_SHARE * count))} if count else {}
    return step_options({**config["video"], **own})


rule capture_photos:
    input:
        images=lambda wildcards: photo_files(pass_column(wildcards))(wildcards),
        masks=mask_files,
        cameras=camera_files,
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    benchmark:
        f"{SCENE}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos", "films"),
        scene="|".join([WHOLE_SCENE, *LATER_PASSES]),
    resources:
        mem_mb=per_attempt(2000),
        runtime=per_attempt(20),
    params:
        images=lambda wildcards: photo_place(wildcards, pass_column(wildcards)),
        method=capture_method,
        odd_names=odd_names,
        options=capture_options,
    message:
        "Taking the pictures of {wildcards.dataset} {wildcards.object}"
    shell:
        "python -m zeroshop_steps.capture --method {params.method} --images {params.images:q} {params.options}"
        " --out {output.capture} > {log} 2>&1"


rule share_capture:
    input:
        folder=lambda wildcards: f"{RESULTS}/{wildcards.dataset}/{scene_owner(wildcards)}/{wildcards.scene}/capture",
    output:
        folder=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    benchmark:
        f"{SCENE}/benchmarks/capture.tsv"
    wildcard_constraints:
        dataset=datasets_of("photos"),
        object=SHARED,
        scene=WHOLE_SCENE,
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    message:
        "Taking the photos that show {wildcards.object}, too"
    shell:
        "python -m zeroshop_steps.capture --method share --folder {input} --out {output} > {log} 2>&1"


ruleorder: share_capture > capture_photos
