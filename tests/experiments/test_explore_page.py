"""The explorer's page in a real headless browser: it loads, follows the keyboard, shows the command line's numbers, fits."""

from __future__ import annotations

import json
import tomllib
import urllib.request
from urllib.parse import urljoin

import pytest
from exploring import exploring, swept
from headless import Browser, find_browser

from experiments.explore.server import Server
from experiments.reporting.formatting import number
from experiments.scenario import Scenario

READY = "document.documentElement.dataset.state === 'ready'"
SIZES = {"laptop": (1280, 720, False), "phone": (390, 844, True)}


@pytest.fixture(scope="module")
def url(small):
    base = small.changed("budget.ranges_m=[2.0, 3.0, 4.0]", 'title="<b>A title</b> & more"')
    with exploring(base) as explorer, Server(explorer) as server:
        yield server.url


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    executable = find_browser()
    if executable is None:
        pytest.skip("no Chromium or Chrome is installed; MANTIS_BROWSER may name one")
    with Browser(executable, tmp_path_factory.mktemp("profile")) as made:
        yield made


@pytest.fixture
def page(browser, url):
    browser.open(url)
    browser.wait_for(READY, 60)
    return browser


def shown(page, gauge):
    """A gauge's number as the page has it."""
    return page.run(f"document.querySelector('[data-name={gauge}] b').firstChild.textContent").lstrip("✓✗ ")


def test_it_loads_without_errors_and_takes_texts_as_texts(page):
    assert page.errors == []
    assert page.run("document.getElementById('title').textContent") == "<b>A title</b> & more"
    assert page.run("document.querySelectorAll('#controls input, #controls select').length") > 15
    assert page.run("document.getElementById('marker').naturalWidth") > 100
    assert page.run("document.getElementById('frame').naturalWidth") == 160
    for chart in ("curve", "histogram", "pose"):
        assert page.run(f"document.querySelectorAll('#{chart} svg[role=img][aria-label]').length") >= 1
    assert page.run(
        "[...document.querySelectorAll('#models td')].map(td => td.textContent).every(t => t && t !== 'NaN')"
    )


def test_a_key_moves_a_slider_and_the_numbers_become_the_command_lines(page, mantis, tmp_path):
    before = shown(page, "cnr")
    page.run("document.body.focus()")
    for _ in range(10):
        page.press("Tab")
        if page.run("document.activeElement.id") == "c-range_m":
            break
    assert page.run("document.activeElement.getAttribute('aria-valuetext')") == "3 m"
    outlined = page.run("getComputedStyle(document.activeElement).outlineStyle")
    assert outlined == "solid"
    page.press("ArrowRight")
    assert page.run("document.activeElement.getAttribute('aria-valuetext')") == "4 m"
    page.wait_for(f"{READY} && location.search === '?range_m=4'", 60)
    assert page.errors == []
    toml = (
        urllib.request.urlopen(
            urljoin(page.run("location.href"), page.run("document.getElementById('save').getAttribute('href')"))
        )
        .read()
        .decode()
    )
    assert Scenario.model_validate(tomllib.loads(toml)).range_m == 4.0
    file = tmp_path / "scenario.toml"
    file.write_text(toml, encoding="utf-8")
    said = swept(mantis, file, 4.0)
    assert shown(page, "cnr") == number(said["cnr_analytic"]) != before
    assert shown(page, "snr") == number(said["snr_analytic"])
    assert shown(page, "sampling") == f"{number(said['px_per_bit'])} px"
    cells = page.run("[...document.querySelectorAll('#models tr')].map(r => [...r.cells].map(c => c.textContent))")
    assert cells[0][3] == number(said["snr_analytic"])
    assert cells[1][1] == number(said["signal_expected"])


def test_every_control_is_reached_and_moved_by_the_keyboard(page):
    reached = []
    for _ in range(60):
        page.press("Tab")
        reached.append(page.run("document.activeElement.id || document.activeElement.tagName"))
        if "save" in reached:
            break
    movable = "#controls input:not(:disabled), #controls select"
    controls = page.run(f"[...document.querySelectorAll('{movable}')].map(e => [e.id, e.name || '', e.type])")
    groups = {name for _, name, kind in controls if kind == "radio"}
    missing = [i for i, _, kind in controls if kind != "radio" and i not in reached]
    assert missing == []
    assert all(any(seen.startswith(group) for seen in reached) for group in groups)
    assert {"save", "link"} <= {*reached, "link"}
    page.run("document.getElementById('c-illumination-0').focus()")
    page.press("ArrowDown")
    page.wait_for(f"{READY} && location.search === '?illumination=sunlit'")
    assert page.run("document.getElementById('c-sun-phase_deg').disabled") is False
    page.run("document.getElementById('c-exposure_s').focus()")
    page.press("End")
    page.wait_for(f"{READY} && location.search.includes('exposure=fixed')")
    assert "✗" in page.run("document.getElementById('verdict').textContent")
    assert "unseen" in page.run("document.querySelector('[data-name=saturation] .unseen').className")


def test_a_link_shows_the_same_point_and_a_wrong_one_says_why(browser, url):
    browser.open(f"{url}?drive=0.5&exposure=fixed&exposure_s=1.5e-6")
    browser.wait_for(READY, 60)
    assert browser.run("document.querySelector('output[for=c-exposure_s]').textContent") == "0.0000015 s"
    assert browser.run("document.querySelector('output[for=c-drive]').textContent").startswith(("× 0.5", "0.5"))
    browser.open(f"{url}?range_m=far")
    browser.wait_for(READY, 60)
    assert browser.run("document.getElementById('error').textContent") == "range_m: 'far', expected a number [m]"
    assert browser.run("document.getElementById('error').hidden") is False
    assert browser.run("document.getElementById('verdict').textContent[0]") in "✓✗"


@pytest.mark.parametrize("size", SIZES)
def test_it_is_readable_at(browser, url, size):
    width, height, mobile = SIZES[size]
    browser.open(url, width, height, mobile=mobile)
    browser.wait_for(READY, 60)
    assert browser.run("document.documentElement.scrollWidth") <= width
    small = browser.run(
        "[...document.querySelectorAll('body *')].filter(e => !e.children.length && e.textContent.trim() && !e.closest('svg')"
        " && e.getClientRects().length && parseFloat(getComputedStyle(e).fontSize) < 12).map(e => e.outerHTML)"
    )
    assert small == []
    spilling = browser.run(
        "[...document.querySelectorAll('body *')].filter(e => !e.closest('.unseen, .skip, .scroll, pre, svg')"
        " && e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 120))"
    )
    assert spilling == []
    verdict = browser.run("document.getElementById('verdict').getBoundingClientRect().bottom")
    assert verdict < height
    if mobile:
        heights = "[...document.querySelectorAll('input[type=range]')].map(e => e.getBoundingClientRect().height)"
        assert min(browser.run(heights)) >= 30  # for a thumb


def test_only_the_newest_of_many_moves_counts(page):
    page.run("document.getElementById('c-drive').focus()")
    for _ in range(8):
        page.press("ArrowLeft")
    text = page.run("document.getElementById('c-drive').getAttribute('aria-valuetext')")
    page.wait_for(f"{READY} && decodeURIComponent(location.search) === '?drive=' + {json.dumps(text)}.slice(2)")
    assert page.errors == []
