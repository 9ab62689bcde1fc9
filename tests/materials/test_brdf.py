"""The reflectance model itself: reciprocity, the tape tables, and tables that are refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from materials.brdf import Lobes, RetroTable, chord_squared
from materials.library import available, load
from radiometry.geometry import FloatArray

NORMAL = np.array([0.0, 0.0, 1.0])
RETRO = [name for name in available() if load(name).lobes.retro is not None]
SHARP = RetroTable((0.1, 0.2, 0.5), (4.0, 30.0), ((300.0, 250.0, 95.0), (180.0, 150.0, 65.0)))

angles = st.floats(0, np.radians(89.9))
azimuths = st.floats(-np.pi, np.pi)


def direction(polar: float, azimuth: float) -> FloatArray:
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def around_bisector(entrance: float, observation: float, turn: float) -> tuple[FloatArray, FloatArray]:
    """Two directions at an angle from each other whose bisector stands at an angle from the normal."""
    bisector = direction(entrance, 0.0)
    side = np.cos(turn) * np.array([np.cos(entrance), 0, -np.sin(entrance)]) + np.sin(turn) * np.array([0, 1.0, 0])
    half = observation / 2
    return np.cos(half) * bisector + np.sin(half) * side, np.cos(half) * bisector - np.sin(half) * side


@settings(deadline=None, derandomize=True)
@given(st.sampled_from(available()), angles, azimuths, angles, azimuths, st.sampled_from([700.0, 850.0, 1000.0]))
def test_every_material_is_reciprocal(
    name: str, theta_a: float, phi_a: float, theta_b: float, phi_b: float, wavelength: float
) -> None:
    a, b = direction(theta_a, phi_a), direction(theta_b, phi_b)
    forward, backward = load(name).brdf(NORMAL, a, b, wavelength), load(name).brdf(NORMAL, b, a, wavelength)
    assert float(forward) == pytest.approx(float(backward), rel=1e-12)
    assert forward > 0


@settings(deadline=None, derandomize=True)
@given(st.sampled_from(RETRO), angles, azimuths, st.floats(-6, -2), azimuths)
def test_tape_is_reciprocal_inside_its_lobe(name: str, theta: float, phi: float, exponent: float, turn: float) -> None:
    a = direction(theta, phi)
    b = a + 10.0**exponent * np.array([np.cos(turn), np.sin(turn), 0])
    b /= np.linalg.norm(b)
    forward, backward = load(name).brdf(NORMAL, a, b, 850.0), load(name).brdf(NORMAL, b, a, 850.0)
    assert float(forward) == pytest.approx(float(backward), rel=1e-12)


@pytest.mark.parametrize("name", available())
def test_a_material_is_dark_on_its_back(name: str) -> None:
    up, down = direction(0.5, 1.0), -direction(0.5, 1.0)
    for source, viewer in ((up, down), (down, up), (down, down)):
        assert load(name).brdf(NORMAL, source, viewer, 850.0) == 0


@pytest.mark.parametrize("name", RETRO)
@pytest.mark.parametrize("turn_deg", [0.0, 37.0, 90.0, 180.0])
def test_tape_returns_its_tabulated_coefficient_at_the_tabulated_angles(name: str, turn_deg: float) -> None:
    """R_A = f cosθ_i cosθ_o (ASTM E810), less the Lambertian floor.

    The table's row is met where the bisector stands at the entrance angle β. There cosθ_i cosθ_o lies between cos²β − sin²(α/2)
    and cos²β cos²(α/2): the rest is rounding.
    """
    material = load(name)
    table = material.lobes.retro
    assert table is not None
    for entrance_deg, row in zip(table.entrance_deg, table.coefficient, strict=True):
        for observation_deg, coefficient in zip(table.observation_deg, row, strict=True):
            beta, alpha = np.radians([entrance_deg, observation_deg])
            source, viewer = around_bisector(beta, alpha, np.radians(turn_deg))
            f = material.brdf(NORMAL, source, viewer, 850.0) - material.diffuse(850.0) / np.pi
            found = float(f / material.retro(850.0)) * source[2] * viewer[2]
            least = np.cos(beta) ** 2 - np.sin(alpha / 2) ** 2
            most = np.cos(beta) ** 2 * np.cos(alpha / 2) ** 2
            assert coefficient * least / np.cos(beta) ** 2 * (1 - 1e-9) <= found
            assert found <= coefficient * most / np.cos(beta) ** 2 * (1 + 1e-9)


@pytest.mark.parametrize("name", RETRO)
def test_below_the_first_observation_angle_the_lobe_is_flat(name: str) -> None:
    table = load(name).lobes.retro
    assert table is not None
    chord = 2 * np.sin(np.radians(table.observation_deg[0]) / 2) * np.array([0.0, 1e-3, 0.5, 1.0])
    value = table.lobe(np, np.cos(np.radians(table.entrance_deg[0])), chord**2)
    np.testing.assert_allclose(value, value[0], rtol=1e-12)


@pytest.mark.parametrize("name", RETRO)
def test_beyond_the_table_the_lobe_falls_as_its_tail_exponent_says(name: str) -> None:
    table = load(name).lobes.retro
    assert table is not None
    last = 2 * np.sin(np.radians(table.observation_deg[-1]) / 2)
    value = table.lobe(np, 1.0, np.array([last, 2 * last, 20 * last]) ** 2)
    np.testing.assert_allclose(value[1:] / value[0], np.array([2.0, 20.0]) ** -table.tail_exponent, rtol=1e-9)


@settings(deadline=None, derandomize=True)
@given(st.floats(0, 0.05), st.floats(0.02, 0.999))
def test_between_the_rows_the_lobe_is_linear_in_the_cosine_and_vanishes_at_grazing(chord: float, cosine: float) -> None:
    first, last = np.cos(np.radians([4.0, 30.0]))
    rows = SHARP.lobe(np, np.array([first, last]), chord**2)
    share = np.clip((first - cosine) / (first - last), 0, 1)
    expected = (rows[0] * (1 - share) + rows[1] * share) * np.clip(cosine / last, 0, 1)
    assert float(SHARP.lobe(np, cosine, chord**2)) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "total"),  # 2π ∫ R_A α dα at the first row, as the audit of the thesis has them
    [("tape_type_iii", 0.083), ("tape_type_ix", 0.317), ("tape_type_xi", 0.493)],
)
def test_the_tail_is_finite_and_the_lobe_returns_what_the_audit_computed(name: str, total: float) -> None:
    """To 30 deg, where the audit's integral ends; an exponent above 2 leaves a finite rest, in closed form."""
    table = load(name).lobes.retro
    assert table is not None
    knots = 2 * np.sin(np.radians(table.observation_deg) / 2)
    scale = np.cos(np.radians(table.entrance_deg[0]))

    def returned(log_chord: float) -> float:  # dω = 2π c dc on small angles, over the logarithm of the chord c
        chord = np.exp(log_chord)
        return float(2 * np.pi * chord**2 * table.lobe(np, scale, chord**2) * scale**2)

    edges = np.log([1e-7, *knots, np.radians(30), 1e9])
    parts = [quad(returned, a, b, limit=200)[0] for a, b in itertools.pairwise(edges)]
    assert sum(parts[:-1]) == pytest.approx(total, abs=0.0005)
    rest = returned(edges[-2]) / (table.tail_exponent - 2)
    assert parts[-1] == pytest.approx(rest, rel=1e-6)


def test_chord_keeps_its_precision_where_a_dot_product_loses_it() -> None:
    """At 1e-8 rad, 1 − cos α is zero in double precision."""
    alpha = 1e-8
    source, viewer = around_bisector(0.3, alpha, 0.7)
    # Components near one are rounded to 1e-16, so a chord of 1e-8 to 1e-8 of itself, its square to 3e-8.
    assert float(chord_squared(source, viewer)) == pytest.approx(alpha**2, rel=6e-8)


@settings(deadline=None, derandomize=True)
@given(st.floats(0, np.pi))
def test_squared_chord_is_twice_one_minus_the_cosine(alpha: float) -> None:
    found = float(chord_squared([1.0, 0, 0], [np.cos(alpha), np.sin(alpha), 0]))
    assert found == pytest.approx(4 * np.sin(alpha / 2) ** 2, rel=1e-14, abs=1e-15)


@settings(deadline=None, derandomize=True)
@given(st.floats(0.01, 1), angles, angles)
def test_a_rough_mirror_is_brightest_where_the_half_vector_is_the_normal(
    alpha: float, theta: float, other: float
) -> None:
    """GGX: along the normal at normal incidence f = 1 / (4π α²), the value of D/4."""
    gloss = Lobes(gloss_alpha=alpha)
    peak = gloss.evaluate(np, 1.0, 1.0, 0.0, diffuse=0.0, gloss=1.0, retro=0.0)
    assert peak == pytest.approx(1 / (4 * np.pi * alpha**2), rel=1e-12)
    a, mirror, off = direction(theta, 0.0), direction(theta, np.pi), direction(theta, np.pi - other)
    at_mirror = gloss.evaluate(np, a[2], mirror[2], chord_squared(a, mirror), diffuse=0.0, gloss=1.0, retro=0.0)
    elsewhere = gloss.evaluate(np, a[2], off[2], chord_squared(a, off), diffuse=0.0, gloss=1.0, retro=0.0)
    assert elsewhere <= at_mirror * (1 + 1e-9)


@pytest.mark.parametrize(
    ("observation", "entrance", "coefficient", "tail", "message"),
    [
        ((0.1, 0.2), (4.0, 30.0), ((300.0, 250.0),), 3.0, "entrance × observation"),
        ((0.1, 0.2), (4.0,), ((300.0,),), 3.0, "entrance × observation"),
        ((0.1, 0.2), (4.0,), ((300.0, 0.0),), 3.0, "R_A > 0"),
        ((0.1, 0.2), (4.0,), ((300.0, -1.0),), 3.0, "R_A > 0"),
        ((0.1, 0.2), (4.0,), ((300.0, float("nan")),), 3.0, "R_A > 0"),
        ((0.2, 0.1), (4.0,), ((300.0, 250.0),), 3.0, "must increase"),
        ((0.1, 0.1), (4.0,), ((300.0, 250.0),), 3.0, "must increase"),
        ((0.1, 0.2), (30.0, 4.0), ((300.0, 250.0), (180.0, 150.0)), 3.0, "must increase"),
        ((0.0, 0.2), (4.0,), ((300.0, 250.0),), 3.0, "exceed 0"),
        ((0.1, 0.2), (-4.0,), ((300.0, 250.0),), 3.0, "0-89 deg"),
        ((0.1, 0.2), (4.0, 90.0), ((300.0, 250.0), (180.0, 150.0)), 3.0, "0-89 deg"),
        ((0.1, 0.2), (4.0,), ((300.0, 250.0),), 2.0, "infinite energy"),
    ],
)
def test_a_table_that_is_none_is_refused(
    observation: tuple[float, ...],
    entrance: tuple[float, ...],
    coefficient: tuple[tuple[float, ...], ...],
    tail: float,
    message: str,
) -> None:
    with pytest.raises(ValueError, match=message):
        RetroTable(observation, entrance, coefficient, tail)
