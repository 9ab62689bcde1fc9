"""The functions of `import mantis` give what the chain gives, and show themselves."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mantis
from experiments import api, chain
from experiments.reporting import notebook
from experiments.reporting.files import write_png
from experiments.scenario import Scenario, load_scenario

SCENARIO = load_scenario()


def test_the_closed_form_over_keys_is_the_budget_of_each_case() -> None:
    axes = {"exposure_s": [1e-6, "auto"], "range_m": [3, 9], "leds.count": [20, 100], "illumination": ["sunlit"]}
    found = api.closed_form(SCENARIO, axes)
    assert dict(found.sizes) == {"exposure_s": 2, "range_m": 2, "leds.count": 2, "illumination": 1}
    assert list(found.snr.dims) == list(axes)
    here = SCENARIO.changed("range_m=9", "leds.count=20", "illumination=sunlit")
    budget = chain.link_budget(here, "sunlit")
    for exposure in (1e-6, "auto"):
        seconds = chain.solve_exposure(here, budget, exposure)
        case = found.sel({"exposure_s": str(exposure), "range_m": 9, "leds.count": 20, "illumination": "sunlit"})
        assert float(case.seconds) == seconds
        for name, value in budget.at(seconds).items():
            assert float(case[name]) == value
    assert found.range_m.attrs["units"] == "m"
    assert found.snr.attrs["long_name"]


def test_the_binding_criterion_is_the_one_with_the_smallest_margin() -> None:
    found = api.closed_form(SCENARIO, {"range_m": [4, 20], "exposure_s": [1 / 30, "auto"]})
    assert found.binds.values.tolist() == [["saturation", "saturation"], ["saturation", "sampling"]]
    assert (found.margin < 1).values.tolist() == [[True, False], [True, True]]


def test_a_marker_outside_the_frame_gives_no_figure() -> None:
    narrow = SCENARIO.changed("camera.width_px=64", "camera.height_px=64")
    found = api.closed_form(narrow, {"range_m": [0.05]})
    assert np.isnan(found.margin.values).all()
    assert found.binds.values.tolist() == ["frame"]


def test_an_unknown_axis_is_refused_with_the_nearest_key() -> None:
    with pytest.raises(ValueError, match="did you mean 'range_m'"):
        api.closed_form(SCENARIO, {"range": [1, 2]})


def test_a_shot_is_what_the_command_line_exposes_and_detects(small: Scenario, tmp_path: Path) -> None:
    shot = api.shoot(small)
    basis = chain.transport(small)
    rate = chain.electron_rate(small, basis, small.illumination)
    np.testing.assert_array_equal(shot.frame, chain.expose(small, rate, small.illumination, shot.exposure_s).dn)
    assert shot.detection.features.detected
    assert shot.range_error < 0.01
    write_png(shot.frame, tmp_path / "frame.png")
    again = api.detect(tmp_path / "frame.png", small)
    assert again.pose is not None
    assert shot.detection.pose is not None
    np.testing.assert_array_equal(again.pose.translation_m, shot.detection.pose.translation_m)
    for page in (notebook.exposure_html(shot), notebook.detected_image_html(again)):
        assert "data:image/png" in page
        assert page.count("<circle") >= 4  # the corners, drawn in the picture
        assert "Position" in page


def test_an_image_without_a_marker_is_shown_whole_with_the_reason() -> None:
    small = SCENARIO.changed("camera.width_px=120", "camera.height_px=80")
    seen = api.detect(np.full((80, 120), 64, np.uint16), small)
    page = notebook.detected_image_html(seen)
    assert 'viewBox="0 0 240 160"' in page
    assert "Not detected" in page


def test_the_stages_by_hand_are_what_one_shot_does(small: Scenario) -> None:
    basis = api.render(small)
    frame = api.expose(small, basis, trial=1)
    np.testing.assert_array_equal(frame.dn, api.shoot(small, trial=1).frame)
    with pytest.raises(ValueError, match="another geometry"):
        api.expose(small.changed("range_m=5"), basis)


def test_a_scenario_shows_what_was_changed_and_escapes_its_title() -> None:
    page = notebook.scenario_html(api.load(None, "title=<b>bold</b>", "leds.count=20"))
    assert "&lt;b&gt;bold" in page
    assert "leds.count" in page.split("<details>")[0]
    assert "leds.fwhm_nm" not in page.split("<details>")[0]
    assert "leds.fwhm_nm" in page
    assert "px per bit" in notebook.budget_html(chain.link_budget(SCENARIO, "sunlit"))


def test_a_key_is_explained_with_its_value_in_a_scenario() -> None:
    changed = SCENARIO.changed("leds.half_angle_deg=9")
    assert api.explain("leds.half_angle_deg", changed).startswith("leds.half_angle_deg = 9.0 deg: angle from the axis")
    assert api.explain("leds.half_angle_deg").startswith("leds.half_angle_deg = 12.0 deg: ")
    assert api.explain("camera.focus_m", SCENARIO).startswith("camera.focus_m = absent: ")
    with pytest.raises(ValueError, match="did you mean"):
        api.explain("leds.half_angle")


def test_an_exposure_that_no_scenario_may_have_is_refused() -> None:
    with pytest.raises(ValueError, match="exposure_s"):
        api.closed_form(SCENARIO, {"exposure_s": [-1.0]})


def test_a_closing_set_of_parameters_is_found_without_rendering() -> None:
    found = api.close(None, "close.ranges_m=[2.0, 10.0, 20.0]", quick=True, render=False)
    assert found.recommended is not None
    assert found.constraints.ranges_m == (2.0, 10.0, 20.0)


def test_the_budget_of_a_scenario_holds_every_case_of_its_plan(small: Scenario) -> None:
    told: list[str] = []
    plan = ("budget.ranges_m=[2.0, 3.0]", "budget.trials=2", 'budget.exposures_s=["auto"]')
    result = api.budget(small.changed(*plan), progress=lambda done, total, what: told.append(what))
    assert dict(result.dataset.cnr_rendered.sizes) == {"range_m": 2, "illumination": 2, "exposure": 1}
    assert told


PUBLIC = [getattr(api, name) for name in api.__all__]


def test_mantis_is_the_functions_of_the_api_and_nothing_else() -> None:
    assert sorted(mantis.__all__) == sorted(api.__all__)
    assert [getattr(mantis, name) for name in api.__all__] == PUBLIC
    assert all(inspect.isfunction(function) for function in PUBLIC)


@pytest.mark.parametrize("function", PUBLIC, ids=api.__all__)
def test_public_functions_are_typed_and_say_what_they_do(function: Callable[..., object]) -> None:
    signature = inspect.signature(function)
    annotations = [p.annotation for p in signature.parameters.values()] + [signature.return_annotation]
    assert inspect.Signature.empty not in annotations
    assert not [text for text in annotations if re.search(r"\bAny\b", str(text))]
    words = (inspect.getdoc(function) or "").split("Args:")[-1]
    assert all(f"{name}:" in words or len(signature.parameters) == 1 for name in signature.parameters)


def _fresh(code: str, *path: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path))}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, env=environment, timeout=120
    )


HOME = Path(mantis.__file__).parent


def test_importing_mantis_loads_nothing_heavy(tmp_path: Path) -> None:
    """Rationale: a notebook's first cell answers at once; each function loads what it needs."""
    run = _fresh("import mantis, sys; print(*sys.modules)", HOME, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert not {"numpy", "cv2", "xarray", "pydantic", "mitsuba", "matplotlib"} & set(run.stdout.split())


@pytest.mark.parametrize("content", ["__init__.py", "notes.txt"], ids=["package", "folder"])
def test_a_package_of_others_that_hides_ours_is_named_in_one_line(tmp_path: Path, content: str) -> None:
    """Also a mere folder of that name hides a package whose own folder is not on the path, as an editable install's."""
    ours, theirs = tmp_path / "ours", tmp_path / "theirs" / "experiments"
    for name in ("radiometry", "materials", "scenes", "detector"):
        (ours / name).mkdir(parents=True)
        (ours / name / "__init__.py").touch()
    (ours / "mantis.py").write_bytes((HOME / "mantis.py").read_bytes())
    theirs.mkdir(parents=True)
    (theirs / content).touch()
    run = _fresh("import mantis", theirs.parent, ours, cwd=tmp_path)
    assert run.returncode == 1
    message = run.stderr.strip().splitlines()[-1]
    assert message.startswith(f"ImportError: mantis: {theirs.resolve()}")
    assert "hides the package experiments" in message


class _Formatter:
    """Records what a running IPython would be told."""

    def __init__(self) -> None:
        self.known: set[tuple[str, str]] = set()

    def for_type_by_name(self, module: str, name: str, show: Callable[[Any], str]) -> None:
        self.known.add((module, name))


def test_results_show_themselves_as_soon_as_mantis_is_imported_in_ipython(monkeypatch: pytest.MonkeyPatch) -> None:
    formatter = _Formatter()
    display = SimpleNamespace(formatters={"text/html": formatter})
    ipython = ModuleType("IPython")
    monkeypatch.setattr(ipython, "get_ipython", lambda: SimpleNamespace(display_formatter=display), raising=False)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    importlib.reload(mantis)
    assert formatter.known == set(notebook.DISPLAYS)
    for module, name in notebook.DISPLAYS:
        assert hasattr(importlib.import_module(module), name)


def test_changes_to_a_scenario_are_those_of_the_command_line() -> None:
    assert SCENARIO.changed("sensor.preset=imx287").digest() == load_scenario(None, ("sensor.preset=imx287",)).digest()
    assert SCENARIO.with_values({"leds.count": 3}).leds.count == 3
