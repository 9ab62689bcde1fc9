"""Transports of many scenarios at once, and what a rendering says of its own noise beside the sensor's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import chain
from experiments.scenario import Scenario, load_scenario
from scenes.files.cache import TransportCache
from scenes.files.exr import read_basis, write_basis
from scenes.projection.regions import frame_box, marker_pixels
from scenes.render.transport import TransportBasis

CROP = ("camera.width_px=64", "camera.height_px=64", "render.marker_rays=400_000")


@pytest.fixture(scope="module")
def scenarios() -> list[Scenario]:
    base = load_scenario(overrides=CROP)
    return [base.at(range_m=r, render=base.render.model_dump() | {"seed": k}) for k, r in enumerate((3.3, 4.0, 3.3))]


@pytest.fixture(scope="module")
def bases(scenarios: list[Scenario]) -> list[TransportBasis]:
    return list(chain.transports(scenarios))


def test_many_transports_are_each_what_they_are_alone(scenarios: list[Scenario], bases: list[TransportBasis]) -> None:
    for scenario, basis in zip(scenarios, bases, strict=True):
        alone = chain.transport(scenario)
        for illumination in alone.layers:
            assert np.array_equal(alone.layers[illumination], basis.layers[illumination])
        assert alone.attributes == basis.attributes
        assert basis.attributes["range_m"] == scenario.range_m
        chain.check_geometry(scenario, basis, "basis")


def test_transports_are_found_in_the_cache(
    scenarios: list[Scenario], bases: list[TransportBasis], tmp_path: Path
) -> None:
    store = TransportCache(tmp_path)
    first = list(chain.transports(scenarios[:2], store))
    again = list(chain.transports([scenarios[1], scenarios[0], scenarios[2]], store))
    assert (store.rendered, store.reused) == (3, 2)
    for found, expected in zip([*first, *again], [bases[0], bases[1], bases[1], bases[0], bases[2]], strict=True):
        for illumination in expected.layers:
            assert np.array_equal(found.layers[illumination], expected.layers[illumination])
            assert np.array_equal(found.noise[illumination], expected.noise[illumination])


def test_the_fraction_is_that_of_pixels_in_the_exposure_and_grows_with_it(
    scenarios: list[Scenario], bases: list[TransportBasis]
) -> None:
    """In proportion to the exposure as long as nothing overflows: the renderer's deviation is relative, shot noise a root."""
    scenario, basis = scenarios[0], bases[0]
    budget = chain.link_budget(scenario, "eclipse")
    seconds = 0.2 * chain.usable_well_electrons(scenario.sensor) / budget.tape_rate
    one = chain.renderer_variance_fraction(scenario, basis, "eclipse", seconds)
    assert chain.renderer_variance_fraction(scenario, basis, "eclipse", 2 * seconds) == pytest.approx(2 * one, rel=1e-6)
    # By hand, without the pool: no pixel of the field is above the worst by more than the pool's 25.
    rate = chain.electron_rate(scenario, basis, "eclipse")
    scale = rate.max() / basis.layers["led"].mean(axis=0).max()
    view = chain.view(scenario)
    seen = marker_pixels(view, frame_box(view))
    pixels = seen.aruco | seen.opening
    alone = (basis.noise["led"][pixels] * scale * seconds) ** 2 / np.maximum(rate[pixels] * seconds, 1e-12)
    assert alone.max() / 25 <= one <= alone.max()


def test_pixels_that_overflow_count_as_full(scenarios: list[Scenario], bases: list[TransportBasis]) -> None:
    """However long the exposure, no pixel holds more than its well: the fraction ends where all are full."""
    scenario, basis = scenarios[0], bases[0]
    fractions = [chain.renderer_variance_fraction(scenario, basis, "sunlit", seconds) for seconds in (1.0, 10.0, 100.0)]
    assert fractions[2] == pytest.approx(fractions[1], rel=0.05)
    assert fractions[0] <= fractions[1] <= fractions[2] * 1.001


def test_the_default_quality_keeps_to_a_tenth_of_shot_variance() -> None:
    scenario = load_scenario(overrides=("camera.width_px=64", "camera.height_px=64", "range_m=3.3"))
    basis = chain.transport(scenario)
    for illumination in ("eclipse", "sunlit"):
        seconds = chain.solve_exposure(scenario, chain.link_budget(scenario, illumination), "auto")
        assert chain.renderer_variance_fraction(scenario, basis, illumination, seconds) < 0.1


def test_noise_is_kept_in_files_and_unknown_without(
    scenarios: list[Scenario], bases: list[TransportBasis], tmp_path: Path
) -> None:
    scenario, basis = scenarios[0], bases[0]
    write_basis(basis, tmp_path / "basis.exr")
    read = read_basis(tmp_path / "basis.exr")
    assert chain.renderer_variance_fraction(scenario, read, "sunlit", 1e-5) == pytest.approx(
        chain.renderer_variance_fraction(scenario, basis, "sunlit", 1e-5), rel=1e-6
    )
    silent = TransportBasis(basis.nodes_nm, basis.layers)
    assert np.isnan(chain.renderer_variance_fraction(scenario, silent, "sunlit", 1e-5))


def test_new_noise_needs_no_new_rendering(scenarios: list[Scenario], tmp_path: Path) -> None:
    store = TransportCache(tmp_path)
    changes = ({}, {"seed": 7}, {"exposure_s": 1e-4}, {"illumination": "sunlit"})
    list(chain.transports((scenarios[0].at(**change) for change in changes), store))
    assert (store.rendered, store.reused) == (1, len(changes) - 1)


def test_density_follows_the_well_but_not_every_sensor() -> None:
    quality = [
        chain.quality(load_scenario(overrides=(f"sensor.full_well_electrons={well}", "sensor.bits=16"))).electrons
        for well in (5e3, 1.9e4, 2.5e4, 3.9e4, 9e4)
    ]
    assert quality[:2] == [2e4, 2e4]
    assert quality == sorted(quality)
    assert len(set(quality)) <= 4
