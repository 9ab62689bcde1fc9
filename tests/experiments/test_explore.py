"""The explorer behind the page: states, what they stand for, answers that agree with the command line, and their speed."""

from __future__ import annotations

import http.client
import json
import socket
import time
from concurrent.futures import Future
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from exploring import Here, answered, exploring, swept
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.sensor.sensor import expose
from experiments import chain
from experiments.explore import closed, frame
from experiments.explore.controls import controls, geometry_of, read_state, scenario_of, write_state, write_value
from experiments.explore.geometries import Budgets, GeometryStore, Prepared, Task
from experiments.explore.server import Server
from experiments.scenario import load_scenario

#: A median answer on the page within this [ms].
LIMIT_MS = 100.0


@pytest.fixture(scope="module")
def base(small):
    return small.changed("budget.ranges_m=[2.0, 3.0]")


@pytest.fixture(scope="module")
def explorer(base):
    with exploring(base) as made:
        yield made


@pytest.fixture(scope="module")
def server(explorer):
    with Server(explorer) as made:
        yield made


def get(server, path, host=None):
    """Status, headers and body of a request."""
    port = int(server.url.rsplit(":", 1)[1].strip("/"))
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers={"Host": host} if host else {})
    reply = connection.getresponse()
    found = reply.status, dict(reply.getheaders()), reply.read()
    connection.close()
    return found


def test_every_control_starts_at_the_scenarios_own_value(base):
    for control in controls(base):
        assert control.start in control.values
        assert len(control.values) == len(control.texts) == len(set(control.values))
    at_start = read_state("", controls(base))
    assert scenario_of(base, at_start).digest() == base.digest()


@settings(deadline=None, derandomize=True)
@given(data=st.data())
def test_a_link_holds_the_state(data, small):
    known = controls(small)
    state = {c.key: data.draw(st.sampled_from(c.values), label=c.key) for c in known}
    assert read_state(write_state(state, known), known) == state


def test_values_of_transport_snap_and_live_ones_do_not(base):
    known = controls(base)
    state = read_state("range_m=2.2&target.yaw_deg=13&exposure_s=1.2345e-6&exposure=fixed&drive=0.77", known)
    assert (state["range_m"], state["target.yaw_deg"]) == (2.0, 10.0)
    assert (state["exposure_s"], state["drive"]) == (1.2345e-6, 0.77)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("rnage_m=2", "rnage_m: not a control"),
        ("range_m=near", "range_m: 'near', expected a number [m]"),
        ("range_m=99", "range_m: 99, expected 2 to 3 [m]"),
        ("illumination=dawn", "illumination: 'dawn', expected one of eclipse, sunlit"),
        ("exposure_s=nan", "expected a number [s]"),
    ],
)
def test_a_wrong_link_is_told_in_one_line(base, query, words):
    with pytest.raises(ValueError, match=r"^[^\n]+$") as caught:
        read_state(query, controls(base))
    assert words in str(caught.value)


def test_large_sensors_are_read_out_in_a_window_about_the_same_axis():
    whole = load_scenario(None, ("sensor.preset=gt4096nir",))
    base = load_scenario()
    cut = scenario_of(base, {**read_state("", controls(base)), "sensor.preset": "gt4096nir"})
    assert (cut.camera.width_px, cut.camera.height_px) == (752, 580)
    assert cut.camera.pixel_pitch_x_m == whole.camera.pixel_pitch_x_m
    middles = [
        (c.principal_point_px - (np.array([c.width_px, c.height_px]) - 1) / 2) for c in (whole.camera, cut.camera)
    ]
    assert np.array_equal(*middles)


def test_led_current_scales_rates_and_budgets_as_the_chain_does(base, explorer):
    answered(explorer, "")
    state = {**read_state("illumination=sunlit&drive=0.3", explorer.controls)}
    prepared = explorer._store.frame(explorer._key(state))
    scenario = scenario_of(base, state)
    basis = chain.transport(geometry_of(base, state))
    for illumination in ("eclipse", "sunlit"):
        exact = chain.electron_rate(scenario, basis, illumination)
        assert np.allclose(prepared.rate(illumination, 0.3), exact, rtol=1e-12, atol=1e-9)
        budget, scaled = (
            chain.link_budget(scenario, illumination),
            prepared.budgets.scaled(0.3).by_illumination[illumination],
        )
        assert scaled.signal_rate == pytest.approx(budget.signal_rate, rel=1e-12)
        assert scaled.background_rate == pytest.approx(budget.background_rate, rel=1e-12)


def test_answers_are_what_the_command_line_gives(explorer, mantis, tmp_path):
    query = "range_m=2&illumination=sunlit&exposure=fixed&exposure_s=4e-7&drive=0.8"
    answer = answered(explorer, query)
    file, basis, png = (tmp_path / name for name in ("scenario.toml", "basis.exr", "frame.png"))
    file.write_text(explorer.toml(query), encoding="utf-8")
    assert mantis("render", file, "-o", basis, "--quiet")[0] == 0
    status, out, _ = mantis("expose", basis, file, "-o", png, "--json")
    assert (status, json.loads(out)["exposure_s"]) == (0, answer["numbers"]["exposure_s"])
    status, out, _ = mantis("detect", png, file, "--json")
    assert status == 0
    detection = json.loads(out)
    for key in ("detected", "id", "reason"):
        assert detection[key] == answer["frame"]["detection"][key]
    assert detection["corners_px"] == pytest.approx(np.array(answer["frame"]["detection"]["corners_px"]), abs=1e-6)
    assert detection["pose"]["t_m"] == pytest.approx(answer["frame"]["detection"]["pose"]["t_m"], rel=1e-9)
    dn = cv2.imread(str(png), cv2.IMREAD_UNCHANGED)
    assert frame.histogram(scenario_of(explorer.base, answer["state"]).sensor, dn) == answer["frame"]["histogram"]
    said = swept(mantis, file, 2.0)
    form, rendered = answer["frame"]["models"]
    for name in ("signal", "background", "snr", "cnr"):
        assert form[name] == pytest.approx(said[f"{name}_analytic"], rel=1e-9)
        assert answer["numbers"]["values"][name] == pytest.approx(said[f"{name}_analytic"], rel=1e-9)
    assert rendered["signal"] == pytest.approx(said["signal_expected"], rel=1e-9)
    assert rendered["background"] == pytest.approx(said["background_expected"], rel=1e-9)
    here, need = answer["curve"]["range_m"].index(2.0), explorer.base.requirement
    margins = {"cnr": said["cnr_analytic"] / need.cnr_min, "sampling": said["px_per_bit"] / need.px_per_bit_min}
    margins["smear"] = need.smear_px_max / said["smear_px"]
    for name, margin in margins.items():
        assert answer["curve"]["margins"][name][here] == pytest.approx(margin, rel=1e-9)


def test_contrast_of_a_pair_is_that_of_drawn_differences(explorer):
    state = read_state(
        "range_m=2&illumination=sunlit&exposure=fixed&exposure_s=3e-7&pair=1&sun.phase_deg=20", explorer.controls
    )
    answer = answered(explorer, write_state(state, explorer.controls))
    scenario, prepared = scenario_of(explorer.base, state), explorer._store.frame(explorer._key(state))
    view, marker = chain.view(scenario), scenario.marker
    sets = [chain.bit_pixels(view, c) for c in (marker.white_bit_centres_m(), marker.black_bit_centres_m())]
    white, black = (tuple(np.concatenate([p[k] for p in pixels]) for k in (0, 1)) for pixels in sets)
    on, led = prepared.rates["sunlit"], prepared.rates["eclipse"]
    rng, seconds = np.random.default_rng(5), answer["numbers"]["exposure_s"]
    drawn = []
    for _ in range(60):
        frames = [expose(scenario.sensor, rate, seconds, rng).dn for rate in (on, on - led)]
        image = frames[0].astype(float) - frames[1]
        drawn.append([image[white], image[black]])
    bright, dark = (np.array([d[k] for d in drawn]) for k in (0, 1))
    variance = bright.var(axis=0, ddof=1).mean() + dark.var(axis=0, ddof=1).mean()
    contrast = (bright.mean() - dark.mean()) / np.sqrt(variance)
    # 59 degrees of freedom a pixel: the relative standard deviation of the root of the summed variance.
    freedom = 59 * min(len(white[0]), len(black[0]))
    assert answer["numbers"]["values"]["cnr"] == pytest.approx(contrast, rel=4 / np.sqrt(2 * freedom) + 0.01)
    assert answer["frame"]["detection"]["detected"]


def test_ellipses_hold_their_share_and_turn_as_the_covariance(base):
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    drawn = np.random.default_rng(2).multivariate_normal([0, 0], covariance, 20_000)
    inside = np.mean([frame._ellipse(covariance, point)["inside"] for point in drawn[:4000]])
    assert inside == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 4000))
    shape = frame._ellipse(covariance, np.zeros(2))
    along = np.radians(shape["angle_deg"])
    direction = np.array([np.cos(along), np.sin(along)])
    assert shape["half"][0] == pytest.approx(frame.ELLIPSE_95 * np.sqrt(direction @ covariance @ direction))
    assert shape["half"][0] > shape["half"][1]


def test_a_range_without_a_bit_in_the_frame_has_no_margin(base):
    lost = chain.LinkBudget(
        sensor=base.sensor,
        signal_rate=np.nan,
        background_rate=np.nan,
        tape_rate=np.nan,
        px_per_bit=30.0,
        smear_px_per_s=0.0,
        fill=np.nan,
    )
    seen = chain.LinkBudget(
        sensor=base.sensor,
        signal_rate=1e9,
        background_rate=1e7,
        tape_rate=1e9,
        px_per_bit=5.0,
        smear_px_per_s=1.0,
        fill=1.0,
    )
    points = [(r, Budgets(dict.fromkeys(("eclipse", "sunlit"), b))) for r, b in ((0.1, lost), (3.0, seen))]
    curve = closed.curve(base, points, pair=False)
    assert curve["margins"]["cnr"][0] is None
    assert curve["margins"]["cnr"][1] > 1


class Broken(Here):
    """An executor whose first task loses its worker."""

    losses = (ConnectionError,)

    def __init__(self):
        self.lost, self.recovered = 0, 0

    def submit(self, aside, *arguments):
        self.lost += 1
        if self.lost == 1:
            future = Future()
            future.set_exception(ConnectionError())
            return future
        return super().submit(aside, *arguments)

    def recover(self):
        self.recovered += 1


def _waits_for(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_the_store_goes_on_after_a_lost_worker_and_tells_why_a_geometry_failed(monkeypatch):
    monkeypatch.setattr("experiments.explore.geometries.closed_form", lambda scenario: Budgets({"eclipse": scenario}))
    executor = Broken()

    def refused():
        raise ValueError("camera.focus_m: wrong")

    tasks = [
        Task("lost", False, "", SimpleNamespace),
        Task("wrong", False, "", refused),
        Task("good", False, "", SimpleNamespace),
    ]
    with GeometryStore(executor) as store:
        store.want("good", lambda: iter(tasks))
        _waits_for(lambda: store.budgets("good") is not None)
        assert executor.recovered == 1
        with pytest.raises(ValueError, match="has died"):
            store.frame("lost")
        with pytest.raises(ValueError, match=r"camera\.focus_m"):
            store.frame("wrong")


def _frames(plan):
    return (Task(f"{plan}{k}", True, "", partial(str, f"{plan}{k}")) for k in range(6))


def test_the_store_keeps_to_its_memory_and_forgets_the_oldest(monkeypatch):
    made = []

    def prepared(scenario):
        made.append(scenario)
        return Prepared({"eclipse": np.zeros(100)}, Budgets({}))

    monkeypatch.setattr("experiments.explore.geometries.prepare", prepared)
    with GeometryStore(Here(), limit_bytes=2000) as store:
        for plan in ("a", "b"):
            store.want(plan, partial(_frames, plan))
            _waits_for(lambda: store.doing == "" and made and made[-1][0] == store._present)
        kept = [n for n in (f"{p}{k}" for p in "ab" for k in range(6)) if store.ready(n)]
        assert kept == ["b1", "b2"]  # of each plan three were made, until they would have filled the memory
        assert made == ["a0", "a1", "a2", "b0", "b1", "b2"]


def test_a_move_is_answered_within_a_tenth_of_a_second(capsys):
    """Default camera, all prepared; CPU time of the answering thread is bounded, for the clock counts what else runs."""
    base = load_scenario(None, ("render.frame_samples=1", "render.marker_rays=200_000", "budget.ranges_m=[4.0, 5.0]"))
    with exploring(base) as explorer:
        for query in ("range_m=4", "range_m=5"):
            answered(explorer, query)
        moves = [
            "range_m=5&illumination=sunlit",
            "range_m=4&drive=0.5",
            "range_m=5&exposure=fixed&exposure_s=2e-6",
            "range_m=4&illumination=sunlit&pair=1",
        ]
        clock, spent = [], []
        for query in moves * 4:
            before = time.thread_time()
            clock.append(explorer.answer(query)["milliseconds"])
            spent.append(1e3 * (time.thread_time() - before))
    with capsys.disabled():
        print(
            f"\nexplore: a move takes {np.median(clock):.0f} ms by the clock, {np.median(spent):.0f} ms of CPU (medians)"
        )
    assert np.median(spent) <= LIMIT_MS


def test_the_server_listens_on_loopback_and_refuses_other_names(server):
    assert server.url.startswith("http://127.0.0.1:")
    assert get(server, "/controls")[0] == 200
    assert get(server, "/controls", host="localhost:1")[0] == 200
    status, _, body = get(server, "/controls", host="attacker.example")
    assert (status, set(json.loads(body))) == (403, {"error"})


def test_the_server_answers_pages_states_and_mistakes(server, explorer):
    pages = {"/": "html", "/explore.js": "javascript", "/charts.js": "javascript", "/explore.css": "css"}
    for path, kind in pages.items():
        status, headers, body = get(server, path)
        assert status == 200
        assert headers["Content-Type"] == f"text/{kind}; charset=utf-8"
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert b"http://" not in body.replace(b"http://www.w3.org/", b"")
    described = json.loads(get(server, "/controls")[2])
    assert [c["key"] for c in described["controls"]] == [c.key for c in explorer.controls]
    answered(explorer, "")
    answer = json.loads(get(server, "/answer?drive=0.5")[2])
    assert answer["state"]["drive"] == 0.5
    assert answer["frame"]["detection"]["detected"]
    assert json.loads(get(server, "/numbers")[2])["frame"] is None
    status, headers, body = get(server, "/scenario.toml?drive=0.5")
    assert (status, headers["Content-Disposition"]) == (200, 'attachment; filename="scenario.toml"')
    assert b"intensity_w_sr = 1.75" in body
    for path, expected in (
        ("/answer?range_m=far", 400),
        ("/scenario.toml?illumination=x", 400),
        ("/../etc/passwd", 404),
        ("/nothing", 404),
    ):
        status, _, body = get(server, path)
        assert status == expected
        assert "\n" not in json.loads(body)["error"]


def test_a_taken_port_is_told_with_what_to_do(mantis, base):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        status, out, err = mantis("explore", "--port", port, "--no-browser")
    assert (status, out) == (2, "")
    assert err.strip() == f"mantis: --port {port}: taken on 127.0.0.1; choose another, or 0 for any that is free"


def test_explore_writes_no_files(mantis, tmp_path):
    status, _, err = mantis("explore", "-o", tmp_path / "x", "--no-browser")
    assert (status, list(tmp_path.iterdir())) == (2, [])
    assert "--out" in err


def test_values_in_links_are_short_and_exact():
    assert [write_value(v) for v in (4.0, 0.075, True, False, "sunlit")] == ["4", "0.075", "1", "0", "sunlit"]
