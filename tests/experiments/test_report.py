"""The HTML report: safe, self-contained, the same every time, and true to the dataset."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
import tomllib
from collections import Counter
from html.parser import HTMLParser
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from experiments import pictures
from experiments.budget.figures import detection_interval
from experiments.budget.report import MAX_PICTURED_RANGES, render_budget_report
from experiments.figures import new_figure
from experiments.report import figure, toml_text
from experiments.scenario import Scenario

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
    return render_budget_report(make_budget())


@pytest.fixture(scope="module")
def hostile_html(make_budget) -> str:
    return render_budget_report(make_budget(title=HOSTILE), f"mantis budget {HOSTILE}")


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
    assert render_budget_report(make_budget()) == html


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
        here = dataset.sel(range_m=float(row["range_m"]), light=row["light"], exposure=row["exposure"])
        assert float(row["cnr_analytic [1]"]) == float(here.cnr_analytic)
        assert float(row["px_per_bit [pixel]"]) == float(here.px_per_bit)
        assert float(row["margin_sampling [1]"]) == float(here.margin.sel(criterion="sampling"))


def test_embedded_scenario_is_the_scenario(make_budget, hostile_html):
    scripts = Page(hostile_html).scripts
    text = next(json.loads(s) for key, s in scripts.items() if key.startswith("reproduce"))
    assert Scenario.model_validate(tomllib.loads(text)).digest() == make_budget(title=HOSTILE).scenario.digest()


def test_plan_of_one_range_light_and_exposure_without_a_sighting_gets_a_report(make_budget):
    plan = {"lights": ("sun",), "ranges_m": (3.0,), "exposures_s": (1e-3,)}
    assert "The budget does not close at 3 m" in render_budget_report(make_budget(found=0.0, budget=plan))


def test_long_plans_show_a_selection_of_pictures(make_budget):
    page = render_budget_report(make_budget(budget={"ranges_m": tuple(np.linspace(1, 5, 40)), "lights": ("eclipse",)}))
    assert page.count("data:image/png") == MAX_PICTURED_RANGES
    assert f"{MAX_PICTURED_RANGES} of the 40 ranges are shown" in page


def test_figures_are_well_formed_and_keep_their_ids_apart():
    texts = []
    for key in ("a", "b"):
        plot, axes = new_figure()
        axes[0, 0].plot([1, 2], [3, 4], label="<&>")
        axes[0, 0].legend()
        texts.append(str(figure(plot, key, 'a "caption" <b>').svg))
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


def test_detection_interval_is_clopper_and_pearsons():
    low, high = detection_interval(np.array([0.0, 0.5, 1.0, np.nan]), 16)
    for found, a, b in zip((0, 8, 16), low, high, strict=False):
        exact = stats.binomtest(found, 16).proportion_ci(0.95, "exact")
        assert (a, b) == pytest.approx((exact.low, exact.high))
    assert (low[3], high[3]) == (0.0, 1.0)


_SCALARS = st.one_of(
    st.booleans(), st.integers(-(2**60), 2**60), st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(exclude_categories=("Cs",))),
)  # fmt: skip


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
