"""The report without a browser: what its pages say of whole, half-done, failed and missing runs, and of what users write."""

import hashlib
import html
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pymeshlab
import pytest
import trimesh

from helpers.paths import REPOSITORY
from helpers.small_report import failed_cell, finished_cell, half_done_cell, made_gallery, made_page
from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.report.site.advice import advise_on_failure
from zeroshop_steps.report.site.charts import scatter
from zeroshop_steps.report.site.mesh_reduction import TEXTURED_FACES, reduce_mesh
from zeroshop_steps.report.site.viewer_data import UNSEEN, quantize_distances
from zeroshop_steps.runtime.files import read_json, write_json

VIEWER = REPOSITORY / "src/zeroshop_steps/report/viewer"


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
    failed_cell(results / "glass", "the reconstruction hangs together but is wrong, or masks are: rays miss by 11.0 px")
    pages = [made_page(results / name, results / "report", "--faces", "500") for name in ("carton", "glass", "later")]
    made_gallery(results / "report", *pages)
    return results / "report"


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
        ("segment", "the object moved during the film: until a.jpg it stands elsewhere than from b.jpg on", "without touching it"),
        (
            "segment",
            "no support plane: no plane holds 30; put the object on a flat surface; nothing stands there",
            "leave one object alone",
        ),
        ("register", "the network finds no matches between the images", "matched no pictures"),
        ("register", "the network found no camera for a.jpg", "register by colmap"),
        ("register", "other views confirm only 3 % of the depth", "sharper pictures"),
    ],
)
def test_each_failure_has_its_advice(step, reason, help):
    assert help in advise_on_failure(step, reason)


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


def test_same_input_same_bytes(tmp_path, carton):
    finished_cell(tmp_path / "demo/carton", carton)
    pages = [made_page(tmp_path / "demo/carton", tmp_path / which, "--faces", "400") for which in ("one", "two")]
    digests = [{path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(page.iterdir())} for page in pages]
    assert digests[0] == digests[1] and len(digests[0]) > 6


def test_distances_of_a_perfect_mesh_are_none_and_of_a_shifted_one_the_shift(tmp_path, carton):
    cell = finished_cell(tmp_path / "demo/carton", carton)
    page = made_page(tmp_path / "demo/carton", tmp_path / "report")
    assert distances_in(page / f"mesh-{'su_h-colmap-2dgs'}.js").max() == 0
    notes = read_json(cell / "mesh.json")
    shifted = np.eye(4)
    shifted[2, 3] = 1.0
    notes["frame_facts"]["object_from_registration"] = shifted.tolist()
    write_json(cell / "mesh.json", notes)
    shutil.rmtree(page)
    page = made_page(tmp_path / "demo/carton", tmp_path / "report")
    found = data_in(page / "mesh-su_h-colmap-2dgs.js")
    millimetres = distances_in(page / "mesh-su_h-colmap-2dgs.js") / 254 * found["limit_mm"]
    assert millimetres.max() == pytest.approx(1.0, abs=0.01) and np.median(millimetres) < 0.01


def data_in(path: Path) -> dict:
    """What a data script hands to the page."""
    return json.loads(path.read_text().removeprefix("zeroshop.data(").removesuffix(");\n"))


def distances_in(path: Path) -> np.ndarray:
    """The levels of distance of a mesh's vertices."""
    import base64

    return np.frombuffer(base64.b64decode(data_in(path)["distances"]), np.uint8)


def test_the_benchmark_has_a_row_for_each_set_of_models(tmp_path):
    head = "dataset,models,task,method,masks,measure,object,value,source"
    rows = ["demo,models,pose,render_compare,truth,ar,,0.91,measured", "demo,models_2dgs,pose,render_compare,truth,ar,,0.87,measured"]
    rows += ["demo,models,detection,contour,,ap,,0.42,measured", "demo,models,pose,render_compare,truth,ar,3,0.5,measured"]
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables/bop.csv").write_text("\n".join([head, *rows]) + "\n")
    made_gallery(tmp_path / "report", tables=tmp_path / "tables")
    page = (tmp_path / "report/tables.html").read_text()
    assert "render_compare, true masks, AR" in page and "contour, AP" in page
    overall, by_object = page.split("<summary>By object</summary>")
    assert all(f">{value}</td>" in overall for value in ("0.910", "0.870", "0.420")) and ">0.500</td>" not in overall
    assert ">0.500</td>" in by_object
    assert ">lost with 2dgs</th>" in page and ">0.040</td>" in page
    assert (tmp_path / "report/downloads/bop.csv").read_text().count("\n") == 5


def test_scores_by_object_lead_to_their_pages(tmp_path, carton):
    finished_cell(tmp_path / "demo/carton", carton)
    write_json(tmp_path / "demo/carton/model/model_info.json", {"obj_id": 3, "name": "carton", "diameter": 115.3})
    page = made_page(tmp_path / "demo/carton", tmp_path / "report", "--faces", "500")
    rows = ["demo,models,pose,render_compare,truth,ar,3,0.5,measured", "demo,models,pose,render_compare,truth,ar,4,0.25,measured"]
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables/bop.csv").write_text("\n".join(["dataset,models,task,method,masks,measure,object,value,source", *rows]) + "\n")
    text = made_gallery(tmp_path / "report", page, tables=tmp_path / "tables").with_name("tables.html").read_text()
    assert re.search(r'<a href="objects/carton/index.html">carton[^<]*</a></th><td class="figure">0.500', text)
    assert '<th scope="row">4</th><td class="figure">0.250' in text


def test_published_tables_stand_beside_ours(tmp_path, carton):
    failed_cell(tmp_path / "ycbv/obj_000013", "2 of 30 images registered, at least 24 are needed")
    page = made_page(tmp_path / "ycbv/obj_000013", tmp_path / "report")
    made_gallery(tmp_path / "report", page, dataset="ycbv")
    text = (tmp_path / "report/tables.html").read_text()
    assert "thesis: MASt3R" in text and 'href="objects/obj_000013/index.html#se-colmap-2dgs"' in text
    assert ">0.0601</td>" in text and ">9.28</td>" in text, "Table 4.3 has the bowl's height"
    assert ">0.751</td>" in text, "Table 4.5"
    assert text.count("<circle") == 17, "Figure 4.8 has the seventeen objects of Tables 4.3 and 4.4"
    rows = (tmp_path / "report/downloads/grades.csv").read_text().splitlines()
    assert sum(row.startswith("thesis,obj_000013") for row in rows) == 13


def test_a_true_model_is_not_passed_off_as_a_mesh(tmp_path, carton):
    shutil.copytree(carton.model.parent, tmp_path / "demo/carton/model")
    index = made_gallery(tmp_path / "report", made_page(tmp_path / "demo/carton", tmp_path / "report", "--faces", "500"))
    assert "The picture is of the true model." in index.read_text()


def test_the_numbers_of_an_axis_differ():
    plot = scatter({"a": [(0.9985, 26.95, "one"), (1.0, 27.0, "two")]}, "x", "y", from_zero=False)
    numbers = re.findall(r'text-anchor="(middle|end)">([0-9.]+)</text>', plot)
    assert len(numbers) > 5 and len(set(numbers)) == len(numbers)


def test_levels_of_distance():
    assert quantize_distances(np.array([0.0, 1.0, 2.0, 9.0, np.nan]), 2.0).tolist() == [0, 127, 254, 254, UNSEEN]


def test_a_reduced_mesh_keeps_its_shape_and_its_texture(carton):
    small = reduce_mesh(carton.mesh, 300, 64)
    assert len(small.mesh.faces) <= 300 and small.faces == len(carton.mesh.faces)
    assert small.mesh.texture.shape == (64, 64, 3)
    assert np.abs(small.mesh.vertices).max(0) == pytest.approx(np.abs(carton.mesh.vertices).max(0), abs=0.1)
    assert small.mesh.as_trimesh().area == pytest.approx(carton.mesh.as_trimesh().area, rel=0.01)


def test_a_reduced_mesh_keeps_its_shape_whatever_the_filter_did_before(carton):
    work = pymeshlab.MeshSet(verbose=False)
    work.add_mesh(pymeshlab.Mesh(carton.mesh.vertices, carton.mesh.faces.astype(np.int32)))
    options = {"preserveboundary": True, "boundaryweight": 2.0, "preservenormal": True, "planarquadric": True, "autoclean": True}
    work.meshing_decimation_quadric_edge_collapse(targetfacenum=1000, **options)
    assert reduce_mesh(carton.mesh, 300, 64).mesh.as_trimesh().area == pytest.approx(carton.mesh.as_trimesh().area, rel=1e-3)


@pytest.mark.slow
def test_a_mesh_beyond_reason_is_reduced_quickly():
    sphere = trimesh.creation.icosphere(8, 50.0)
    mesh = Mesh(np.array(sphere.vertices), np.array(sphere.faces, np.int64))
    assert len(mesh.faces) > TEXTURED_FACES
    small = reduce_mesh(mesh, 5000, 64)
    assert 1000 < len(small.mesh.faces) <= 5000
    assert np.linalg.norm(small.mesh.vertices, axis=1) == pytest.approx(50.0, abs=0.5)


def test_the_bundled_scripts_are_those_of_their_sources():
    names = ["build.mjs", "package-lock.json", "package.json", *(f"src/{path.name}" for path in sorted(VIEWER.glob("src/*")))]
    digest = hashlib.sha256()
    for name in names:
        digest.update(f"{name}\n".encode() + (VIEWER / name).read_bytes())
    for script in ("page.js", "viewer.js"):
        head = (VIEWER.parent / "assets" / script).read_text().partition("\n")[0]
        assert head == f"/* sources {digest.hexdigest()} */", "the scripts have changed: run `make viewer`"
    assert "MIT" in (VIEWER.parent / "assets/three.LICENSE.txt").read_text()
