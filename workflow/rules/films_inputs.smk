"""What the rules of films take."""

import os

from zeroshop_steps.runtime import failures


def is_filmed(dataset):
    """Whether the captures of a dataset are rendered films, which from there on go the way of a user's own."""
    return dataset_named(dataset)["kind"] == "films"


def film_row(wildcards):
    """What a row of objects.tsv would say of a rendered film."""
    folder = f"results/{wildcards.dataset}/{wildcards.object}/film"
    scene = "" if config["datasets"][wildcards.dataset]["board"] == "beside" else f"{folder}/empty_scene"
    row = {"images": f"{folder}/film.mp4", "height_method": "marker", "marker_images": scene}
    return {**dict.fromkeys(("masks", "prompt", "depth"), ""), "height_m": None, **row}


def filmed_model(wildcards):
    """The model that is filmed."""
    check_object(wildcards)
    of = config["datasets"][wildcards.dataset]["of"]
    [dataset] = [name for name, names in of.items() if wildcards.object in names]
    return f"results/{virtual_dataset(dataset, 'Films are of models.')}/{wildcards.object}/model"


def film_board(wildcards):
    """Where the board lies."""
    return config["datasets"][wildcards.dataset]["board"]


def film_files(name):
    """An input function: this file of every film of a dataset, a failure where it could not be made."""
    registration = config["chosen"]["photos"]["registration"]

    def files(wildcards):
        os.environ[failures.SWITCH] = "1"
        place = name.format(registration=registration, nvs=table_axis("nvs")[0])
        return [f"results/{wildcards.dataset}/{item}/{place}" for item in objects_of(wildcards.dataset)]

    return files
