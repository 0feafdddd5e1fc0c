"""Shop products made by code: textured models of known size, so that the whole workflow runs without any download.

Every product is a closed mesh in millimetres in BOP's layout: model.ply, model.png and model_info.json.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

from zeroshop_steps.geometry.images import write_image
from zeroshop_steps.geometry.meshes import write_ply
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.synthetic.products.assemble import Product, make_model_info, make_textured_mesh
from zeroshop_steps.synthetic.products.cans import tomato_can, tuna_can
from zeroshop_steps.synthetic.products.cartons import cracker_carton, gelatin_carton
from zeroshop_steps.synthetic.products.mustard import mustard_bottle
from zeroshop_steps.synthetic.products.tableware import bowl, mug, pitcher
from zeroshop_steps.synthetic.products.tools import clamp, marker
from zeroshop_steps.synthetic.products.tube import toothpaste_tube

CATALOGUE: tuple[Callable[[], Product], ...] = (
    cracker_carton,
    gelatin_carton,
    tomato_can,
    tuna_can,
    mustard_bottle,
    pitcher,
    mug,
    bowl,
    toothpaste_tube,
    marker,
    clamp,
)
"""In the order of their object identifiers, which start at 1."""


def list_demo_objects() -> list[str]:
    """Names of all demo objects, in the order of their identifiers."""
    return [product.__name__ for product in CATALOGUE]


def write_demo_object(name: str, out: Path) -> None:
    """Write model.ply, model.png and model_info.json of one product into the folder `out`.

    Raises StepError for a name that is not in the catalogue.
    """
    names = list_demo_objects()
    if name not in names:
        raise StepError(f"there is no demo object {name!r}; there are {', '.join(names)}")
    number = names.index(name)
    write_product(CATALOGUE[number](), name, number + 1, out)


def write_product(product: Product, name: str, number: int, out: Path) -> None:
    """Write model.ply, model.png and model_info.json of a product with an object identifier into the folder `out`."""
    mesh = make_textured_mesh(product)
    out = Path(out)
    write_image(out / "model.png", mesh.texture_image)
    write_ply(out / "model.ply", mesh, "model.png")
    write_json(out / "model_info.json", make_model_info(mesh, product, name, number))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the method's options."""
    parser.add_argument("--object", required=True, help=f"one of {', '.join(list_demo_objects())}")
    parser.add_argument("--out", type=Path, required=True, help="folder for model.ply, model.png and model_info.json")


def run(args: argparse.Namespace) -> None:
    """Write one demo object."""
    write_demo_object(args.object, args.out)
