"""Shop products made by code: textured models of known size, so that the whole workflow runs without any download.

Every product is a closed mesh in millimetres in BOP's layout: model.ply, model.png and model_info.json.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
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
    write_product(CATALOGUE, "demo object", name, out)


def write_product(catalogue: Sequence[Callable[[], Product]], kind: str, name: str, out: Path) -> None:
    """Write model.ply, model.png and model_info.json of a product into the folder `out`.

    Args:
        catalogue: the products in the order of their object identifiers, which start at 1.
        kind: what they are, for messages.
        name: of the product.
        out: the folder.

    Raises:
        StepError: the catalogue has no such product.
    """
    names = [product.__name__ for product in catalogue]
    if name not in names:
        raise StepError(f"there is no {kind} {name!r}; there are {', '.join(names)}")
    number = names.index(name)
    product = catalogue[number]()
    mesh = make_textured_mesh(product)
    out = Path(out)
    write_image(out / "model.png", mesh.texture_image)
    write_ply(out / "model.ply", mesh, "model.png")
    write_json(out / "model_info.json", make_model_info(mesh, product, name, number + 1))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the method's options."""
    parser.add_argument("--object", required=True, help=f"one of {', '.join(list_demo_objects())}")
    parser.add_argument("--out", type=Path, required=True, help="folder for model.ply, model.png and model_info.json")


def run(args: argparse.Namespace) -> None:
    """Write one demo object."""
    write_demo_object(args.object, args.out)
