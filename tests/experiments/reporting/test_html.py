"""The page in the browser: safe, self-contained, the same every time, and true to the dataset."""

from __future__ import annotations

import base64
import csv
import io
import itertools
import json
import re
import tomllib
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from headless import Browser, find_browser
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.reporting import pictures
from experiments.reporting.blocks import Plot
from experiments.reporting.figures import new_figure
from experiments.reporting.html import embedded
from experiments.scenario import Scenario
from experiments.scenario.toml import toml_text
from experiments.studies.budget.page import MAX_PICTURED_RANGES
from experiments.studies.budget.page import page as budget_page
from experiments.thesis.tradeoff.page import page as tradeoff_page
from experiments.thesis.tradeoff.problem import load as load_problem
from experiments.thesis.tradeoff.study import run as run_tradeoff

HOSTILE = """</title><script>alert('1')</script><img src=x onerror=alert(2)> & "quoted" ]]>"""
VOID = {"meta", "br", "image", "img", "link", "input"}


class Page(HTMLParser):
    """Tags, attributes and embedded files of a page; fails where tags do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str, str]] = []
        self.scripts: dict[str, str] = {}
        self.current: str | None = None
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags[tag] += 1
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.current = dict(attrs).get("id") or "code"

    def handle_startendtag(self, tag, attrs):
        self.tags[tag] += 1
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self.current = None

    def handle_data(self, data):
        if self.current:
            self.scripts[self.current] = self.scripts.get(self.current, "") + data


@pytest.fixture(scope="module")
def html(make_budget) -> str:
    """The page of a budget."""
    return budget_page(make_budget()).html()


@pytest.fixture(scope="module")
def hostile_html(make_budget) -> str:
    return budget_page(make_budget(title=HOSTILE), f"mantis budget {HOSTILE}").html()


def test_texts_of_the_scenario_and_command_are_escaped(html, hostile_html):
    plain, page = Page(html), Page(hostile_html)
    assert page.tags == plain.tags
    assert not [a for a in page.attributes if a[1].startswith("on")]


def test_nothing_is_loaded_from_elsewhere(html):
    for _, name, value in Page(html).attributes:
        if name in ("src", "href", "xlink:href", "action", "data", "srcset"):
            assert value.startswith(("#", "data:")), (name, value)
    assert not re.search(r"@import|url\((?!#)", html)


def test_ids_are_unique_and_every_reference_has_its_target(html):
    ids = Counter(value for _, name, value in Page(html).attributes if name == "id")
    assert [key for key, count in ids.items() if count > 1] == []
    used = (
        set(re.findall(r'href="#([^"]+)"', html))
        | set(re.findall(r"url\(#([^)]+)\)", html))
        | set(re.findall(r'data-from="([^"]+)"', html))
    )
    assert used <= set(ids)


def test_same_result_gives_the_same_bytes(make_budget, html):
    assert budget_page(make_budget()).html() == html


def test_verdict_comes_first_and_marks_are_words_as_well_as_colour(html):
    body = html[html.index("<body>") :]
    assert body.index("The budget does not close over 1–4 m") < body.index("<svg")
    failing = re.findall(r'<td class="fail"[^>]*>(.*?)</td>', html)
    assert failing
    assert all("✗" in cell and "fails" in cell for cell in failing)


def test_embedded_csv_holds_the_dataset(make_budget, html):
    dataset = make_budget().dataset
    rows = list(csv.DictReader(io.StringIO(json.loads(Page(html).scripts["table-2"]))))
    assert len(rows) == dataset.exposure_s.size
    for row in rows:
        here = dataset.sel(range_m=float(row["range_m"]), illumination=row["illumination"], exposure=row["exposure"])
        assert float(row["cnr_analytic [1]"]) == float(here.cnr_analytic)
        assert float(row["px_per_bit [pixel]"]) == float(here.px_per_bit)
        assert float(row["margin_sampling [1]"]) == float(here.margin.sel(criterion="sampling"))


def test_embedded_scenario_is_the_scenario(make_budget, hostile_html):
    scripts = Page(hostile_html).scripts
    text = next(json.loads(s) for key, s in scripts.items() if key.startswith("reproduce"))
    assert Scenario.model_validate(tomllib.loads(text)).digest() == make_budget(title=HOSTILE).scenario.digest()


def test_plan_of_one_range_light_and_exposure_without_a_detection_gets_a_page(make_budget):
    plan = {"illuminations": ("sunlit",), "ranges_m": (3.0,), "exposures_s": (1e-3,)}
    assert "The budget does not close at 3 m" in budget_page(make_budget(found=0.0, budget=plan)).html()


def test_long_plans_show_a_selection_of_pictures(make_budget):
    plan = {"ranges_m": tuple(np.linspace(1, 5, 40)), "illuminations": ("eclipse",)}
    page = budget_page(make_budget(budget=plan)).html()
    assert page.count("data:image/png") == MAX_PICTURED_RANGES
    assert f"{MAX_PICTURED_RANGES} of the 40 ranges are shown" in page


def test_figures_are_well_formed_and_keep_their_ids_apart():
    texts = []
    for key in ("a", "b"):
        plot, axes = new_figure()
        axes[0, 0].plot([1, 2], [3, 4], label="<&>")
        axes[0, 0].legend()
        texts.append(str(embedded(Plot(key, plot, 'a "caption" <b>'), "page")))
    ids = [{e.get("id") for e in ElementTree.fromstring(text).iter() if e.get("id")} for text in texts]
    assert ids[0]
    assert not ids[0] & ids[1]


def test_pictures_repeat_whole_pixels_and_draw_corners_where_they_are(make_budget):
    shot = make_budget().snapshots[0]
    picture = pictures.marker_picture(shot.frame, shot.features, np.array([80.2, 59.9]), 40.0, np.zeros((4, 2)))
    png = base64.b64decode(re.search(r"base64,([^\"]+)", picture.svg)[1])
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    scale = picture.enlarged
    assert scale == pictures.PICTURE_PX // 41
    assert image.shape == (41 * scale, 41 * scale)
    coarse = image[::scale, ::scale]
    assert np.array_equal(image, coarse.repeat(scale, 0).repeat(scale, 1))
    crop = shot.frame[40:81, 60:101].astype(int)
    by_charge = coarse.ravel()[np.argsort(crop, axis=None)].astype(int)
    assert np.all(np.diff(by_charge) >= 0)
    x, y = map(float, re.search(r'<circle cx="([\d.]+)" cy="([\d.]+)"', picture.svg).groups())
    assert (x, y) == pytest.approx(((70 - 60 + 0.5) * scale, (50 - 40 + 0.5) * scale))


def test_marker_at_the_edge_of_the_frame_is_cropped_not_refused(make_budget):
    result = make_budget(found=0.0)
    shot = result.snapshots[0]
    picture = pictures.marker_picture(shot.frame, shot.features, np.array([2.0, 118.0]), 40.0, np.zeros((4, 2)))
    assert "stroke-dasharray" in picture.svg


_SCALARS = st.one_of(
    st.booleans(),
    st.integers(-(2**60), 2**60),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(exclude_categories=("Cs",))),
)


@settings(deadline=None, derandomize=True)
@given(
    st.dictionaries(
        st.from_regex(r"[a-z_]{1,8}", fullmatch=True),
        st.one_of(
            _SCALARS,
            st.lists(_SCALARS, max_size=3),
            st.dictionaries(st.from_regex(r"[a-z_]{1,8}", fullmatch=True), _SCALARS),
        ),
        max_size=4,
    )
)
def test_toml_is_read_back_as_it_was(data):
    assert tomllib.loads(toml_text(data)) == data


PARTS = ("verdict", "evidence", "assumptions", "reproduce")
#: Reports that `make quick` writes; what else lies in out/quick is held to the same.
QUICK = ("budget", "validate", "materials", "glare", "close", "errata", "tradeoff", "montecarlo")


def check_report(text: str) -> None:
    """Hold a page to the four parts in order, each with something in it, and to loading nothing from elsewhere."""
    page = Page(text)
    parts = [value for _, name, value in page.attributes if name == "data-part"]
    assert tuple(parts) == PARTS
    cuts = [text.index(f'data-part="{part}"') for part in PARTS] + [
        text.index("<footer>") if "<footer>" in text else -1
    ]
    bodies = [re.sub(r"<[^>]+>", " ", text[a:b]) for a, b in itertools.pairwise(cuts)]
    assert all(len(body.split()) > 10 for body in bodies)
    assert re.search(r'class="headline', text)
    assert re.search(r"\bmantis [a-z]+", bodies[3])
    assert "mantis-radiometry" in bodies[3]
    assert re.search(r"[Ss]eed \d+|Nothing in it is random", bodies[3])
    for tag, name, value in page.attributes:
        if name in ("src", "href", "xlink:href", "action", "data", "srcset", "poster"):
            assert value.startswith(("#", "data:")), (tag, name, value)
    assert not re.search(r"@import|url\((?!#)", text)
    assert page.tags["link"] == page.tags["iframe"] == page.tags["object"] == 0


def test_budget_has_the_four_parts_in_order(html):
    check_report(html)


def test_tradeoff_has_the_four_parts_in_order():
    check_report(tradeoff_page(run_tradeoff(load_problem()), "mantis tradeoff").html())


def test_every_quick_report_has_the_four_parts_in_order():
    folder = Path("out/quick")
    if not folder.is_dir():
        pytest.skip("`make quick` has not been run here; CI runs it before the tests")
    reports = sorted(folder.glob("*/report.html"))
    assert {path.parent.name for path in reports} >= set(QUICK)
    for path in reports:
        check_report(path.read_text(encoding="utf-8"))


def test_tables_sort_by_size_save_as_csv_and_do_not_widen_the_page(html, tmp_path):
    executable = find_browser()
    if executable is None:
        pytest.skip("no Chromium or Chrome is installed; MANTIS_BROWSER may name one")
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    with Browser(executable, tmp_path / "profile") as browser:
        for width in (390, 1250):
            browser.open(path.as_uri(), width, 800)
            assert browser.errors == []
            assert browser.run("document.documentElement.scrollWidth") <= width
        browser.run("window.saved = []; save = (text, name) => saved.push([text, name])")
        browser.run("document.querySelector('button.csv').click()")
        [[text, name]] = browser.run("saved")
        rows = list(csv.DictReader(io.StringIO(text)))
        shown = "document.querySelector('table.sortable')"
        assert len(rows) == browser.run(f"{shown}.tBodies[0].rows.length")
        assert name.endswith(".csv")
        exposure = list(rows[0])[2]
        browser.run(f"{shown}.tHead.rows[1].cells[2].querySelector('button').click()")
        browser.run("document.querySelector('button.csv').click()")
        again = list(csv.DictReader(io.StringIO(browser.run("saved[1][0]"))))
        assert [float(row[exposure]) for row in again] == sorted(float(row[exposure]) for row in rows)
        sizes = browser.run("['1.5 µs', '900 ns', '2.2×10⁸', '1,200', '17\\u00a0500', '×3', '60 %', 'none'].map(size)")
        assert sizes[:7] == pytest.approx([1.5e-6, 900e-9, 2.2e8, 1200, 17500, 3, 60])
        assert sizes[7] is None
