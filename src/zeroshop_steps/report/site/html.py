"""HTML by Jinja2 with escaping on, and the files that every page shares."""

import functools
import shutil
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jinja2

from zeroshop_steps.methods import TITLES
from zeroshop_steps.runtime.files import atomic_write

PACKAGE = Path(__file__).parents[1]
MARKS = {"good": "●", "sparse": "○", "none": "×", None: "…"}
SCENES = {"su_l": "plain ground", "su_h": "textured ground", "se": "no ground", "su_b": "with a printed board", "video": "photos"}


@functools.cache
def make_environment() -> jinja2.Environment:
    """The Jinja2 environment of the templates. All values are escaped, and an unknown name is an error."""
    found = jinja2.Environment(
        loader=jinja2.FileSystemLoader(PACKAGE / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= {"url": quote_path, "number": format_number, "named": format_method}
    found.globals |= {"MARKS": MARKS, "SCENES": SCENES}
    return found


def write_page(path: Path, template: str, **content: Any) -> None:
    """Render a template into a file."""
    text = make_environment().get_template(template).render(**content)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def copy_assets(folder: Path) -> None:
    """Put styles, scripts and their licences into `folder`."""
    for source in sorted((PACKAGE / "assets").iterdir()):
        with atomic_write(folder / source.name) as temporary:
            shutil.copyfile(source, temporary)


def quote_path(path: str) -> str:
    """A relative path as a link: spaces, umlauts, # and ? percent-encoded."""
    return quote(str(path), safe="/")


def make_link(page: str, place: str) -> str:
    """A link to an element of a page by its id."""
    return f"{quote_path(page)}#{quote(place, safe='')}"


def format_method(name: str) -> str:
    """The name of a method as papers write it."""
    return TITLES.get(name, name)


def format_number(value: object, digits: int = 3) -> str:
    """A number with `digits` significant digits; a dash for None."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return "–" if value is None else str(value)
    if isinstance(value, int) or abs(value) >= 10**digits:
        return f"{value:,.0f}".replace(",", "\u202f")
    return f"{value:.{digits}g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.1e}"
