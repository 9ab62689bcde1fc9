"""The closed form agrees with the renderer, and the validation notices where it does not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from detector.sensor.sensor import Sensor, moments
from experiments import chain
from experiments.scenario import load_scenario
from experiments.studies.validate import crosscheck, study
from experiments.studies.validate import summary as validate_summary
from experiments.studies.validate.cells import QUANTITIES, at_geometry, cropped, noise_statistics, why_not
from experiments.studies.validate.page import page
from experiments.studies.validate.plan import Plan
from experiments.studies.validate.study import COARSE_TOLERANCE, DIMS, FINE_TOLERANCE, ValidationResult, compare
from radiometry import link
from scenes.projection.visible import hidden_face, visible_tape

PLAN = Plan((2.5, 20.0), (0.05,), (40.0,), (45.0, 75.0), draws=16, rays=200_000)


@pytest.fixture(scope="module")
def dataset() -> xr.Dataset:
    return compare(load_scenario(), PLAN)


def test_every_cell_agrees_within_its_tolerance(dataset: xr.Dataset) -> None:
    assert dataset.signal_rendered.dims == DIMS
    assert dataset.agrees.all(), list(validate_summary.outside(dataset))
    assert dataset.tolerance.values.ravel().tolist() == [FINE_TOLERANCE, COARSE_TOLERANCE]
    assert set(dataset.reason.values.ravel()) == {""}


def test_the_error_budget_explains_what_is_left(dataset: xr.Dataset) -> None:
    for quantity in ("signal", "background"):
        known = dataset.remainder.sel(quantity=quantity)
        left = dataset[f"{quantity}_difference"].isel(sensor=0) - known.sel(source="facets")
        # Two seeds give their standard deviation to a factor of two or so; 1e-3 is the sunlight on the cavities' floors.
        assert float(abs(left).max()) < 1e-3 + 5 * float(known.sel(source="monte_carlo").max())


def test_effects_have_the_size_that_physics_gives_them(dataset: xr.Dataset) -> None:
    eclipse = dataset.effect_on_signal.sel(illumination="eclipse", tilt_deg=40.0, size_m=0.05)
    # The bits are within 1 cm of the axis and the LEDs 5 cm: cos³¹ of 50/2500 is 1 − 31/2 (1/50)² to a tenth.
    assert float(eclipse.sel(range_m=2.5, effect="led_pattern")) == pytest.approx(31 / 2 / 50**2, rel=0.1)
    assert float(eclipse.sel(range_m=20.0, effect="neighbours")) > 1  # half of a bit of 0.45 px is its black neighbours
    assert abs(float(eclipse.sel(range_m=2.5, effect="surroundings"))) < 1e-9  # out of the kernel's reach
    assert float(eclipse.sel(range_m=20.0, effect="surroundings")) < -1e-3


def _with_wrong_signal(dataset: xr.Dataset) -> xr.Dataset:
    wrong = dataset.copy(deep=True)
    wrong["signal_analytic"] *= 1.02
    return study.judged(wrong)


def test_a_wrong_closed_form_is_found_out(dataset: xr.Dataset) -> None:
    judged = _with_wrong_signal(dataset)
    assert not judged.agrees.sel(range_m=2.5).any()
    assert judged.agrees.sel(range_m=20.0).all()
    lines = list(validate_summary.outside(judged))
    assert len(lines) == judged.sizes["illumination"] * judged.sizes["sensor"]
    assert "differs by 1.9" in lines[0] or "differs by 2.0" in lines[0]


def test_wrong_noise_is_found_out() -> None:
    sensor, rate, rng = Sensor(read_noise_electrons=20.0), np.full(200, 1e5), np.random.default_rng(1)
    right = noise_statistics(sensor, rate, 1e-3, 32, rng)
    spread = np.sqrt(2 / right["noise_freedom"])
    assert abs(right["noise_variance_ratio"] - 1) < 4 * spread
    assert abs(right["noise_mean_z"]) < 4
    # The same draws held against a sensor with a tenth less read noise.
    other = moments(sensor.model_copy(update={"read_noise_electrons": 18.0}), rate[:1], 1e-3)[1]
    ratio = right["noise_variance_ratio"] * moments(sensor, rate[:1], 1e-3)[1] / other
    assert ratio > 1 + 4 * spread


def test_bits_outside_the_frame_are_told_and_not_validated() -> None:
    plan = Plan((0.3,), (0.20,), (0.0,), (45.0,), rays=100_000)
    result = compare(load_scenario(), plan)
    assert result.reason.item() == "the ArUco square leaves the frame"
    assert np.isnan(result.signal_rendered).all()
    assert result.agrees.all()
    assert validate_summary.summary(result)["validated"] == 0


def test_cropping_moves_no_pixel() -> None:
    here = at_geometry(load_scenario(), 5.0, 0.1, 40.0)
    assert why_not(here) == ""
    small = cropped(here)
    assert small.camera.width_px < here.camera.width_px
    shift = (
        np.array([here.camera.width_px - small.camera.width_px, here.camera.height_px - small.camera.height_px])
    ) / 2
    assert np.all(shift == np.round(shift))
    corners = here.marker.corners_m
    np.testing.assert_allclose(
        chain.view(here).to_image(corners) - shift, chain.view(small).to_image(corners), atol=1e-9
    )
    a, b = (chain.link_budget(s, "sunlit") for s in (here, small))
    assert a.signal_rate == pytest.approx(b.signal_rate, rel=1e-12)
    assert a.background_rate == pytest.approx(b.background_rate, rel=1e-9)


def test_the_tilt_is_the_angle_between_normal_and_line_of_sight() -> None:
    for tilt_deg in (0.0, 20.0, 40.0):
        rotation = chain.view(at_geometry(load_scenario(), 4.0, 0.1, tilt_deg)).rotation
        assert np.degrees(np.arccos(np.clip(-rotation[2, 2], -1, 1))) == pytest.approx(tilt_deg, abs=1e-5)


def test_slits_show_their_floor_where_the_blob_is() -> None:
    """The share of visible floor peaks where the plane through camera and virtual line cuts the front."""
    view = chain.view(at_geometry(load_scenario(), 4.0, 0.1, 20.0))
    cells, shares = visible_tape(view)
    printed = len(view.marker.reflective_rectangles_m())
    assert np.all(shares[:printed] == 1)
    assert 0 < shares[printed:].max() <= 1 - view.marker.slat_fraction
    camera, top = view.to_marker(np.zeros(3)), view.marker.elements[0]
    on_plane = view.to_plane(cells[printed:].mean(axis=1))
    of_top = np.abs(on_plane @ top.across[:2] - top.centre_m @ top.across) < top.width_m / 2
    centre = np.average(on_plane[of_top] @ top.along[:2], weights=shares[printed:][of_top])
    pitch = top.length_m / view.marker.slit_count
    assert centre == pytest.approx(float(top.blob_offset_m(camera)), abs=pitch / 2)


def test_the_marker_hides_more_of_the_face_from_the_sun() -> None:
    view = chain.view(at_geometry(load_scenario(), 4.0, 0.1, 40.0))
    outlines = hidden_face(view)
    pixel = view.to_image(np.array([[0.0, 0.0, 0.0]]))
    camera, sun = (link.reflective_fill(pixel, outlines[key][None], 40.0)[0] for key in ("led", "sun"))
    assert camera < sun < 1


def _result(dataset: xr.Dataset) -> ValidationResult:
    checks = (crosscheck.Agreement("electron rate", "another program", 1.0005, 1.0, 1e-4),)
    return ValidationResult(load_scenario(), dataset, checks, {"bright bits, led": 0.0})


def test_figures_and_table_hold_every_cell(dataset: xr.Dataset, tmp_path: Path) -> None:
    page(_result(dataset)).write(tmp_path)
    for name in ("agreement", "error-budget"):
        assert (tmp_path / "figures" / f"validation-{name}.svg").stat().st_size > 10_000
    lines = (tmp_path / "data" / "validation-cells.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + dataset.agrees.size
    assert all(f"{name}_difference" in lines[0] for name in QUANTITIES)


def test_the_page_says_what_agrees_and_what_does_not(dataset: xr.Dataset) -> None:
    good, bad = page(_result(dataset)), page(_result(_with_wrong_signal(dataset)))
    assert good.headline == "12 of 12 cells agree, and 1 of 1 cross-checks by other people's code."
    assert (good.passed, bad.passed) == (True, False)
    assert not good.unmet
    assert bad.unmet["agrees"].startswith("6 outside, first: 2.5 m, 5 cm, 40 deg, eclipse, scenario")
    assert good.record()["tables"]["crosschecks"][0]["ours over theirs, less one"] == "+5.0e-04"


def test_the_verb_exits_with_4_where_a_required_cell_is_out(
    dataset: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mantis: Callable[..., tuple[int, str, str]]
) -> None:
    monkeypatch.setattr(crosscheck, "run", lambda scenario: ([], {}))
    for data, status in ((dataset, 0), (_with_wrong_signal(dataset), 4)):
        monkeypatch.setattr(study, "compare", lambda *a, data=data, **k: data)
        assert mantis("validate", "--quick", "--out", tmp_path)[0] == 0
        got, _, error = mantis("validate", "--require", "agrees", "--json", "--out", tmp_path)
        assert got == status
        assert ("2.5 m, 5 cm, 40 deg" in error) == (status == 4)
