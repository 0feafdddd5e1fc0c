"""Names of objects: those that exist, and names that people know for those with numbers, such as mustard_bottle for obj_000005 of YCB-V.

results/DATASET/NAME/METHOD.ply   a link to the mesh of the object that NAME stands for, with links to the files beside it
"""

NAMED_FILES = {"mesh": "ply", "texture": "png", "glb": "glb", "facts": "json", "preview": "preview.png"}


def other_names(
    dataset,
):
    """Other names of a dataset's objects, each with the object that it stands for; a name that an object has is that object's."""
    names = config["datasets"].get(dataset, {}).get("names") or {}
    return {name: known for name, known in names.items() if name not in objects_of(dataset)}


def check_object(
    wildcards,
):
    """Raise an error that lists what exists where a path names an unknown dataset or object, or an object by another name."""
    names, others = objects_of(wildcards.dataset), other_names(wildcards.dataset)
    if wildcards.object in others:
        raise WorkflowError(
            f"{wildcards.object} is another name of {others[wildcards.object]}; ask for this file by that one."
            f" Only a mesh is found by both, such as {RESULTS}/{wildcards.dataset}/{wildcards.object}/2dgs.ply"
        )
    where = config["objects_table"] if config["datasets"][wildcards.dataset]["kind"] == "photos" else "config/config.yaml"
    what = f"object of dataset {wildcards.dataset}"
    require_known(what, wildcards.object, [*names, *others], f"Objects of this dataset are listed in {where}.")


def named_files(
    wildcards,
):
    """The mesh of the object that a name stands for, and the files beside it."""
    folder = f"{RESULTS}/{wildcards.dataset}/{other_names(wildcards.dataset)[wildcards.object]}"
    return [f"{folder}/{wildcards.nvs}.{end}" for end in NAMED_FILES.values()]


# Paths of links, as a regular expression of the object in them: only here may an object be called by another name.
NAMED = "|".join(
    rf"(?<={RESULTS}/{dataset}/)(?:{'|'.join(names)})(?=/[^/.]+\.(?:{'|'.join(NAMED_FILES.values())})$)"
    for dataset in config["datasets"]
    if (names := other_names(dataset))
)


wildcard_constraints:
    object=rf"(?!(?:bop|tables|report)/)(?!{NAMED or '(?!)'})[^/]+",  # these folders hold what belongs to a whole dataset


localrules:
    name_mesh,


rule name_mesh:
    input:
        named_files,
    output:
        **{name: f"{OBJECT}/{{nvs}}.{end}" for name, end in NAMED_FILES.items()},
    log:
        f"{OBJECT}/logs/name.{{nvs}}.log",
    benchmark:
        f"{OBJECT}/benchmarks/name.{{nvs}}.tsv"
    wildcard_constraints:
        object=NAMED or "(?!)",
    resources:
        mem_mb=per_attempt(100),
        runtime=per_attempt(5),
    message:
        "{wildcards.object} of {wildcards.dataset} is another name: linking the mesh at {output.mesh}"
    shell:
        "python -m zeroshop_steps.finish --method link_mesh --files {input} --links {output} > {log} 2>&1"
