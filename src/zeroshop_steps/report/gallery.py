"""The start page of the report: all objects of a dataset and its tables. It needs a browser, but no server and no internet.

The report opens from disk. Pages, pictures and data lie beside each other, and 3D data is loaded when it is viewed.
"""

import argparse
import json
from pathlib import Path

from zeroshop_steps.report.site.html import copy_assets, quote_path, write_page
from zeroshop_steps.report.site.tables_page import write_tables
from zeroshop_steps.runtime.files import atomic_write, read_json

HOW_TO_ADD = "Objects of your own are rows of config/objects.tsv; those of other datasets stand in config/config.yaml."

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--dataset", required=True, help="its name")
    parser.add_argument("--pages", type=Path, nargs="*", default=[], help="folders of the objects' pages, in the order of the gallery")
    parser.add_argument("--tables", type=Path, help="folder of the dataset's tables; those that are there are shown")
    parser.add_argument("--out", type=Path, required=True, help="index.html; the pages lie in objects/ beside it")


def run(args: argparse.Namespace) -> None:
    """Write index.html and the files that all pages share. index.html is written last: if it exists, the report is complete."""
    folder = args.out.parent
    cards = [make_gallery_card(read_json(page / "card.json")) for page in args.pages]
    copy_assets(folder / "assets")
    with atomic_write(folder / "assets/objects.js") as temporary:
        temporary.write_text(
            f"zeroshopObjects={json.dumps([[card['name'], quote_path(card['page'])] for card in cards])};\n", encoding="ascii"
        )
    counts = {name: sum(card["best"] == name for card in cards) for name in ("good", "sparse", "none", "unfinished")}
    content = {
        "dataset": args.dataset,
        "cards": cards,
        "counts": counts,
        "summary": summarize_cards(cards),
        "how_to_add": HOW_TO_ADD,
        "root": "",
    }
    write_tables(folder, cards, args.dataset, args.tables)
    write_page(args.out, "index.html", **content)


def make_gallery_card(card: dict) -> dict:
    """What the gallery shows of an object: the chosen cells, the number of others, and the best grade of the shown cells."""
    place = f"objects/{card['object']}"
    shown = [cell for cell in card["cells"] if cell["chosen"]] or card["cells"][:3]
    others = len(card["cells"]) - len(shown)
    order = ["good", "sparse", "none"]
    grades = [cell["grade"] for cell in shown if cell["state"] != "unfinished"]
    best = min(grades, key=order.index) if grades else "unfinished"
    advice = next((cell["advice"] for cell in shown if cell["advice"]), None)
    return card | {
        "page": f"{place}/index.html",
        "data": f"{place}/viewer.js",
        "thumbnail": f"{place}/{card['thumbnail']}" if card["thumbnail"] else None,
        "shown": shown,
        "more": f"and {others} other cell{'s' if others > 1 else ''}" if others else None,
        "best": best,
        "of_truth": bool(card["thumbnail"]) and not any(cell["state"] == "done" for cell in card["cells"]),
        "advice": advice,
    }


def summarize_cards(cards: list[dict]) -> str:
    """The number of objects and of finished, failed and unfinished cells, in one line."""
    cells = [cell for card in cards for cell in card["cells"]]
    states = {state: sum(cell["state"] == state for cell in cells) for state in ("done", "failed", "unfinished")}
    words = [f"{len(cards)} object{'s' if len(cards) != 1 else ''}", f"{states['done']} finished cell{'s' if states['done'] != 1 else ''}"]
    words += [f"{states[state]} {state}" for state in ("failed", "unfinished") if states[state]]
    return ", ".join(words)
