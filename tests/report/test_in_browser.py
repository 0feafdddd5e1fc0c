"""The report in headless Chromium: it draws, links its views, asks nobody for anything and has no errors."""

import cv2
import numpy as np
import pytest

from helpers.browser import browser, chromium
from helpers.small_report import failed_cell, finished_cell, made_gallery, made_page
from zeroshop_steps.runtime.files import write_json

EVIL = '<img src=x onerror="window.ran = true"><script>window.ran = true</script>'
pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine (Debian: apt-get install chromium)")


@pytest.fixture(scope="module")
def report(tmp_path_factory, carton):
    """A report of two objects, in a folder whose name needs escaping."""
    results = tmp_path_factory.mktemp("Größe & co") / "demo"
    finished_cell(results / "carton", carton)
    write_json(results / "carton/model/model_info.json", {"name": EVIL, "diameter": 115.3})
    failed_cell(results / "glass", "2 of 30 images registered, at least 24 are needed")
    pages = [made_page(results / name, results / "report", "--faces", "800") for name in ("carton", "glass")]
    made_gallery(results / "report", *pages)
    return results / "report"


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    """A browser for all tests of this file."""
    with browser(tmp_path_factory.mktemp("browser") / "profile") as found:
        yield found


@pytest.fixture(autouse=True)
def clean(tab):
    """Nothing leaves the machine and nothing is complained of, in any test."""
    tab.requests.clear()
    tab.problems.clear()
    yield
    assert tab.requests_that_left() == []
    assert tab.problems == []


def drawn(tab, path) -> np.ndarray:
    """(height, width, 3) picture of the viewer's part of the page."""
    place = tab.value("(({x, y, width, height}) => [x, y, width, height])(document.querySelector('.viewer-view').getBoundingClientRect())")
    tab.picture(path)
    x, y, width, height = (round(value) for value in place)
    return cv2.imread(str(path))[y : y + height, x : x + width]


def ready(tab, report, **options) -> None:
    """Open the carton's page and wait for its meshes."""
    tab.open(report / "objects/carton/index.html", **options)
    tab.wait_for("document.querySelector('[data-viewer]').dataset.ready")
    settle(tab)


def press(tab, key: str) -> None:
    """Press a key in the viewer."""
    tab.value(f"document.querySelector('.viewer-view').dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))")


def settle(tab) -> None:
    """Wait until what was asked for is drawn."""
    tab.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 100))))")


def differing(one: np.ndarray, other: np.ndarray) -> float:
    """Share of pixels that differ clearly."""
    return float((np.abs(one.astype(int) - other).max(2) > 12).mean())


@pytest.mark.parametrize("page", ["index.html", "tables.html", "objects/carton/index.html", "objects/glass/index.html"])
@pytest.mark.parametrize("width_px", [1280, 390])
def test_a_page_opens_and_fits(tab, report, page, width_px):
    tab.open(report / page, width_px=width_px, height_px=844)
    assert tab.value("document.documentElement.scrollWidth <= innerWidth"), "the page is wider than the screen"
    assert tab.value("document.querySelectorAll('h1').length") == 1
    broken = "[...document.images].filter((image) => image.loading !== 'lazy' && image.naturalWidth === 0).length"
    tab.wait_for("[...document.images].every((image) => image.loading === 'lazy' || image.complete)")
    assert tab.value(broken) == 0
    assert tab.value("window.ran === undefined"), "a name that looks like HTML is text"


def test_the_viewer_draws_mesh_and_truth_alike(tab, report, tmp_path):
    ready(tab, report)
    tab.value("document.querySelectorAll('.viewer-bar .buttons')[1].children[0].click()")
    settle(tab)
    seen = drawn(tab, tmp_path / "view.png")
    ground = seen[40, 5]
    halves = [(np.abs(half.astype(int) - ground).max(2) > 20)[60:-60] for half in np.array_split(seen, 2, axis=1)]
    assert all(0.05 < half.mean() < 0.6 for half in halves), "each pane shows an object"
    assert halves[0].mean() == pytest.approx(halves[1].mean(), rel=0.03), "the mesh is the truth, so both panes show as much"


def test_each_way_of_drawing_shows_something_else(tab, report, tmp_path):
    ready(tab, report)
    views = []
    for key in "1234":
        press(tab, key)
        settle(tab)
        views.append(drawn(tab, tmp_path / f"{key}.png"))
    for one, other in ((0, 1), (1, 2), (2, 3), (0, 3)):
        assert differing(views[one], views[other]) > 0.02


def test_views_turn_together(tab, report, tmp_path):
    ready(tab, report)
    before = drawn(tab, tmp_path / "before.png")
    for _ in range(4):
        press(tab, "ArrowLeft")
    settle(tab)
    after = drawn(tab, tmp_path / "after.png")
    for one, other in zip(np.array_split(before, 2, axis=1), np.array_split(after, 2, axis=1), strict=True):
        assert differing(one, other) > 0.05
    press(tab, "r")
    settle(tab)
    assert differing(before, drawn(tab, tmp_path / "reset.png")) < 0.001


def test_the_scale_bar_is_true(tab, report, tmp_path):
    """Seen from the side and from so far away that perspective matters little, the carton is 90 mm high by the bar."""
    ready(tab, report)
    press(tab, "a")
    for key in ("ArrowDown", "ArrowDown", *"-------"):
        press(tab, key)
    settle(tab)
    millimetres, pixels = tab.value(
        "(({textContent, offsetWidth}) => [parseFloat(textContent), offsetWidth])(document.querySelector('.scale span'))"
    )
    pane = np.array_split(drawn(tab, tmp_path / "side.png"), 2, axis=1)[0][40:-40]
    rows = np.flatnonzero((np.abs(pane.astype(int) - pane[0, 5]).max(2) > 20).any(1))
    assert np.ptp(rows) / pixels * millimetres == pytest.approx(90.0, rel=0.08)


def test_a_table_sorts(tab, report):
    tab.open(report / "tables.html")
    column = "[...document.querySelectorAll('table')].at(-1).tBodies[0].rows"
    values = f"[...{column}].map((row) => row.cells[1].textContent)"
    tab.value("[...document.querySelectorAll('table')].at(-1).tHead.rows[0].cells[1].firstChild.click()")
    assert tab.value(values) == sorted(tab.value(values)) != []
    tab.value("[...document.querySelectorAll('table')].at(-1).tHead.rows[0].cells[1].firstChild.click()")
    assert tab.value(values) == sorted(tab.value(values), reverse=True)


def test_the_gallery_finds_and_looks(tab, report):
    tab.open(report / "index.html")
    shown = "[...document.querySelectorAll('[data-card]')].filter((card) => !card.hidden).length"
    tab.value("(() => { const box = document.querySelector('[data-find]'); box.value = 'cart'; box.dispatchEvent(new Event('input')); })()")
    assert tab.value(shown) == 1
    tab.value("document.querySelector('[data-look-at]').click()")
    tab.wait_for("document.querySelector('dialog .viewer')?.dataset.ready")
    assert tab.value("document.querySelectorAll('dialog .pane').length") == 2


@pytest.mark.slow
def test_looks_give_their_graphics_back(tab, report):
    """Browsers keep some sixteen contexts of WebGL, and complain of more."""
    tab.open(report / "index.html")
    for _ in range(20):
        tab.value("document.querySelector('[data-look-at]').click()")
        tab.wait_for("document.querySelector('dialog .viewer')?.dataset.ready")
        tab.value("document.querySelector('dialog').close()")
        tab.wait_for("!document.querySelector('dialog .viewer')")
    assert tab.value("document.querySelectorAll('canvas').length") == 0


def test_keys_lead_to_the_neighbours_of_an_object_with_a_name(tab, report):
    ready(tab, report)
    assert tab.value("document.querySelectorAll('[data-neighbours] a').length") == 2
    # The key leaves the page: it is pressed after this call has been answered.
    tab.value("void setTimeout(() => dispatchEvent(new KeyboardEvent('keydown', {key: ']'})), 50)")
    tab.wait_for("document.querySelector('[data-neighbours] a') && location.pathname.includes('/objects/glass/')")


def test_day_and_night(tab, report, tmp_path):
    tab.open(report / "index.html", dark=True)
    tab.picture(tmp_path / "dark.png")
    tab.value("document.querySelector('[data-theme-button]').click()")
    tab.picture(tmp_path / "light.png")
    tab.value("localStorage.clear()")
    assert cv2.imread(str(tmp_path / "dark.png")).mean() < 80 < 180 < cv2.imread(str(tmp_path / "light.png")).mean()
