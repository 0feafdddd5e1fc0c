"""The report without a browser: what its pages say of whole, half-done, failed and missing runs, and of what users write."""

import hashlib
import html
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from helpers.small_report import failed_cell, finished_cell, half_done_cell, made_gallery, made_page
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import look_at, make_intrinsics
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.report.site.advice import advise_on_failure
from zeroshop_steps.report.site.svg_plots import scatter
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.segment.objects import NothingFound, find_objects


class Links(HTMLParser):
    """The addresses that a page names, and the tags that it has."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.addresses, self.tags, self.ids = [], [], set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.ids |= {value for name, value in attributes if name == "id"}
        self.addresses += [value for name, value in attributes if name in ("href", "src") and value]


def broken_links(page: Path) -> list[str]:
    """Addresses that lead to no file, or to a place that the file lacks."""
    broken = []
    for address in Links(page).addresses:
        place, _, fragment = address.partition("#")
        target = (page.parent / unquote(place)).resolve() if place else page
        lacks_place = fragment and target.suffix == ".html" and target.is_file() and unquote(fragment) not in Links(target).ids
        if not address.startswith("data:") and (not target.is_file() or lacks_place):
            broken.append(address)
    return broken


@pytest.fixture(scope="module")
def report(tmp_path_factory, carton):
    """The folder of a report of three objects: one with a finished, a failed and a half-done cell, one failed, one not started."""
    root = tmp_path_factory.mktemp("report")
    results = root / "results/demo"
    finished_cell(results / "carton", carton)
    failed_cell(results / "carton", "2 of 30 images registered, at least 24 are needed; take more pictures with more overlap")
    half_done_cell(results / "carton")
    failed_cell(results / "glass", "the reconstruction is self-consistent but incorrect, or masks are: rays miss by 11.0 px")
    pages = [made_page(results / name, results / "report", "--faces", "500") for name in ("carton", "glass", "later")]
    made_gallery(results / "report", *pages)
    return results / "report"


def test_a_model_and_a_mesh_without_colour_have_a_page(tmp_path, carton):
    cell = finished_cell(tmp_path / "carton", carton)
    for path in (cell / "mesh.ply", tmp_path / "carton/model/model.ply"):
        write_ply(path, replace(carton.mesh, uv=None, texture=None))
    page = made_page(tmp_path / "carton", tmp_path / "report", "--faces", "500")
    assert {"truth.js", "thumbnail.webp", "mesh-su_h-colmap-2dgs.js"} <= {path.name for path in page.iterdir()}


def test_every_link_leads_somewhere(report):
    pages = sorted(report.rglob("*.html"))
    assert len(pages) == 5
    assert {str(page): broken_links(page) for page in pages if broken_links(page)} == {}


def test_nothing_in_it_names_another_machine(report):
    for path in [*report.rglob("*.html"), *report.rglob("assets/page.js"), *report.rglob("*.css")]:
        addresses = re.findall(r"(?:https?:)?//[a-z0-9.-]+\.[a-z]{2,}", path.read_text(encoding="utf-8"))
        assert addresses == [], path


def test_states_are_told(report):
    cells = {cell["key"]: cell for cell in read_json(report / "objects/carton/card.json")["cells"]}
    assert {key: (cell["state"], cell["grade"]) for key, cell in cells.items()} == {
        "su_h-colmap-2dgs": ("done", "sparse"),
        "se-colmap-2dgs": ("failed", "none"),
        "su_l-colmap-2dgs": ("unfinished", None),
    }
    assert [name for name, done in cells["su_l-colmap-2dgs"]["steps"] if done] == ["register", "train"]
    assert next(iter(cells)) == "su_h-colmap-2dgs", "the chosen cell comes first"
    index = (report / "index.html").read_text()
    assert "picture is of the true model" not in index
    assert "1 finished cell, 2 failed, 1 unfinished" in index and "not started" in index


def test_cells_say_what_helps(report):
    cells = {cell["key"]: cell["advice"] for cell in read_json(report / "objects/carton/card.json")["cells"]}
    assert "more texture under the object" in cells["se-colmap-2dgs"]
    assert "distances in the viewer" in cells["su_h-colmap-2dgs"]
    assert "last step done is train" in cells["su_l-colmap-2dgs"]
    glass = read_json(report / "objects/glass/card.json")["cells"]
    assert "contradict the masks" in glass[0]["advice"]
    assert "contradict the masks" in (report / "index.html").read_text()


@pytest.mark.parametrize(
    ("step", "reason", "help"),
    [
        (
            "segment",
            "until a.jpg the photos show a thing elsewhere than from b.jpg on: the object moved, or another",
            "without touching it",
        ),
        (
            "register",
            "by colmap: the background stands still in the photos while the object turns (74% of what matches does not move), and what"
            " turns is too little to find the cameras (too few); move the camera instead, or give masks; by aliked: 2 images registered",
            "move the camera around it instead",
        ),
        ("register", "the cameras of all 9 photos see the object from nearly the same direction, within 8 degrees", "go all around"),
        ("register", "all images in capture/images are alike; the camera must move around the object", "All photos show the same"),
        ("register", "by aliked: the network did something new", "sharper pictures"),
        (
            "register",
            "by colmap: the 10 photos do not show one scene, or do not overlap: 2 photos (a.jpg to b.jpg), 4 that fit to no other fit"
            " together; by aliked: 7 of 10 images registered",
            "leave the object where it lies",
        ),
        ("register", "the network finds no matches between the images", "matched no pictures"),
        ("register", "the network found no camera for a.jpg", "register by colmap"),
        ("evaluate", "the raw mesh was made without cameras", "surface method that uses cameras"),
        ("register", "other views confirm only 3 % of the depth", "sharper pictures"),
    ],
)
def test_each_failure_has_its_advice(step, reason, help):
    assert help in advise_on_failure(step, reason)


def test_where_no_object_was_found_no_masks_are_blamed():
    cameras = [Camera("a.png", 32, 24, make_intrinsics(40, 32, 24), look_at(np.array([0.0, -5, 3]), np.zeros(3)))] * 8
    with pytest.raises(NothingFound, match="no object was found .* a part of something larger, draw masks") as failure:
        find_objects(cameras, None, np.zeros(3), 5.0, [np.full((24, 32), -3.0, np.float32)] * 8)
    advice = advise_on_failure("segment.saliency", str(failure.value))
    assert "leave one object alone" in advice and "needs your own masks" in advice


def test_names_and_texts_of_users_are_shown_and_never_run(tmp_path, carton):
    evil = '<script>alert("1")</script><img src=x onerror=alert(2)>'
    name = "Grüße & Küche 100%#1?"
    folder = tmp_path / "results/photos" / name
    cell = finished_cell(folder, carton)
    write_json(folder / "model/model_info.json", {"name": evil, "diameter": 115.0})
    grade = read_json(cell / "grade.json")
    write_json(cell / "grade.json", grade | {"reasons": [evil]})
    failed_cell(folder, evil)
    page = made_page(folder, tmp_path / "report", "--faces", "500", "--config", 'objects_table="<mine>.tsv"')
    index = made_gallery(tmp_path / "report", page, dataset=evil)
    for path in (page / "index.html", index, tmp_path / "report/tables.html"):
        assert "alert(2)" in path.read_text(), "the text is shown"
        assert "<script>alert" not in path.read_text() and "<img src=x" not in path.read_text()
        assert broken_links(path) == []
    assert "Grüße" in index.read_text(encoding="utf-8")
    words = html.unescape((page / "index.html").read_text(encoding="utf-8"))
    assert """/mesh.ply --config 'objects_table="<mine>.tsv"'""" in words, "what was changed of the config stands in the command"


def test_a_dataset_without_objects(tmp_path):
    index = made_gallery(tmp_path / "report")
    assert "no objects yet" in index.read_text() and broken_links(index) == []
    assert broken_links(tmp_path / "report/tables.html") == []


def test_a_damaged_mesh_costs_its_view_and_no_more(tmp_path, carton, capsys):
    cell = finished_cell(tmp_path / "demo/carton", carton)
    (cell / "mesh.ply").write_bytes((cell / "mesh.ply").read_bytes()[:2000])
    page = made_page(tmp_path / "demo/carton", tmp_path / "report", "--faces", "500")
    assert "left out" in capsys.readouterr().err
    assert [cell["state"] for cell in read_json(page / "card.json")["cells"]] == ["done"]
    made_gallery(tmp_path / "report", page)
    assert broken_links(page / "index.html") == []


@pytest.mark.parametrize(
    "damaged", ["model/model.ply", "model/model_info.json", "su_h/colmap/2dgs/mesh.json", "su_h/colmap/cameras/sparse"]
)
def test_what_is_damaged_is_left_out_and_said(tmp_path, carton, capsys, damaged):
    finished_cell(tmp_path / "demo/carton", carton)
    place = tmp_path / "demo/carton" / damaged
    if place.is_dir():
        shutil.rmtree(place)
    else:
        place.write_text("{}" if damaged.endswith("mesh.json") else "half of")
    page = made_page(tmp_path / "demo/carton", tmp_path / "report", "--faces", "500")
    assert "warning: " in capsys.readouterr().err
    made_gallery(tmp_path / "report", page)
    assert broken_links(page / "index.html") == []


@pytest.mark.slow
def test_same_input_same_bytes(tmp_path, carton):
    finished_cell(tmp_path / "demo/carton", carton)
    pages = [made_page(tmp_path / "demo/carton", tmp_path / which, "--faces", "400") for which in ("one", "two")]
    digests = [{path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(page.iterdir())} for page in pages]
    assert digests[0] == digests[1] and len(digests[0]) > 6


def test_a_true_model_is_not_passed_off_as_a_mesh(tmp_path, carton):
    shutil.copytree(carton.model.parent, tmp_path / "demo/carton/model")
    index = made_gallery(tmp_path / "report", made_page(tmp_path / "demo/carton", tmp_path / "report", "--faces", "500"))
    assert "The picture is of the true model." in index.read_text()


def test_the_numbers_of_an_axis_differ():
    plot = scatter({"a": [(0.9985, 26.95, "one"), (1.0, 27.0, "two")]}, "x", "y", from_zero=False)
    numbers = re.findall(r'text-anchor="(middle|end)">([0-9.]+)</text>', plot)
    assert len(numbers) > 5 and len(set(numbers)) == len(numbers)
