"""The page of tables: scores of the benchmark, links to objects, and published figures beside ours."""

import re

from helpers.small_report import failed_cell, finished_cell, made_gallery, made_page
from zeroshop_steps.runtime.files import write_json


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
