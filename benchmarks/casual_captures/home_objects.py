"""Toys and things at home, made by code, for captures as people take them; models as of demo objects."""

from collections.abc import Callable
from pathlib import Path

from casual_captures.home import apple, computer_mouse, desk_lamp, potted_plant, tissue_box, white_vase
from casual_captures.household import candlestick, floor_lamp, flower_vase, hammer, pliers, toaster
from casual_captures.toys import doll_chair, rubber_duck, teddy, thin_figure
from zeroshop_steps.synthetic.demo_objects import write_product
from zeroshop_steps.synthetic.products.assemble import Product

HOME_OBJECTS: tuple[Callable[[], Product], ...] = (
    rubber_duck,
    teddy,
    thin_figure,
    doll_chair,
    apple,
    tissue_box,
    computer_mouse,
    white_vase,
    potted_plant,
    desk_lamp,
    pliers,
    hammer,
    floor_lamp,
    flower_vase,
    toaster,
    candlestick,
)
"""In the order of their object identifiers, which start at 1."""


def list_home_objects() -> list[str]:
    """Names of all of them, in the order of their identifiers."""
    return [product.__name__ for product in HOME_OBJECTS]


def write_home_object(name: str, out: Path) -> None:
    """Write model.ply, model.png and model_info.json of one of them into the folder `out`.

    Raises StepError for a name that is not among them.
    """
    write_product(HOME_OBJECTS, "home object", name, out)
