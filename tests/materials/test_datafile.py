"""Data files: sources, ends of life, a user's own file, and one clear line about a wrong one."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from materials.datafile import parse
from materials.library import END_OF_LIFE, available, fingerprint, load, widest_half_angle_deg

HEAD = 'title = "mine"\nsource = "my bench"\ndate = "2026-11"\nuncertainty = "5 percent"\nassumption = false\n'
PAINT = HEAD + "[diffuse]\nalbedo = 0.3\n"
RETRO = "[retro]\nobservation_deg = [0.1, 0.5]\nentrance_deg = [4.0, 30.0]\ncoefficient_cd_per_lx_m2 = [[90, 20], [40, 9]]\n"
WORN = '[end_of_life]\nretro = 0.5\nsource = "lamp"\ndate = "2026-11"\nuncertainty = "half"\nassumption = true\n'
FRESH = [name for name in available() if not name.endswith(END_OF_LIFE)]


def write(folder: Path, text: str, name: str = "mine.toml") -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    "name",
    [
        "tape_type_iii",
        "tape_type_ix",
        "tape_type_xi",
        "spectralon",
        "white_paint",
        "black_coating",
        "acrylic_black",
        "mli_bare",
        "mli_foil",
        "aluminium",
    ],
)
def test_every_material_of_the_thesis_has_a_beginning_and_an_end_of_life(name: str) -> None:
    assert {name, name + END_OF_LIFE} <= set(available())


@pytest.mark.parametrize("name", available())
def test_spectra_hold_from_700_to_1000_nm_and_do_not_end_there(name: str) -> None:
    material = load(name)
    for nm in (400.0, 700.0, 850.0, 1000.0, 1100.0):
        assert material.diffuse(nm) > 0
    assert material.diffuse(650.0) == material.diffuse(700.0)


@pytest.mark.parametrize("name", [n for n in available() if n.endswith(END_OF_LIFE)])
def test_the_end_of_life_scales_each_lobe_and_keeps_its_shape(name: str) -> None:
    fresh, worn = load(name.removesuffix(END_OF_LIFE)), load(name)
    assert worn.lobes == fresh.lobes
    assert worn.source != fresh.source
    assert worn.assumption  # no measurement after years in orbit is known for any of them
    for nm in (700.0, 850.0, 1000.0):
        for lobe in ("diffuse", "gloss", "retro"):
            before, after = getattr(fresh, lobe), getattr(worn, lobe)
            assert after(nm) * before(850.0) == pytest.approx(before(nm) * after(850.0), rel=1e-12)


def test_ageing_goes_the_way_it_must() -> None:
    for name in ("tape_type_iii", "tape_type_xi", "white_paint", "spectralon", "mli_foil", "mli_bare", "aluminium"):
        assert load(name + END_OF_LIFE).albedo(0.0, 850.0) < load(name).albedo(0.0, 850.0)
    for name in ("black_coating", "acrylic_black"):
        assert load(name + END_OF_LIFE).albedo(0.0, 850.0) > load(name).albedo(0.0, 850.0)


@pytest.mark.parametrize(
    ("nm", "n", "k"), [(700.0, 1.929, 8.1425), (825.0, 2.736, 8.2255), (850.0, 2.587, 8.168), (1000.0, 1.4357, 9.494)]
)
def test_metals_follow_fresnel_with_the_constants_of_their_source(nm: float, n: float, k: float) -> None:
    """n, k of Rakić (1995), linear between his wavelengths; the files round to 0.01 (foil) and 0.001 (sheet)."""
    reflectance = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    film, sheet = load("mli_bare"), load("aluminium")
    assert film.diffuse(nm) + film.gloss(nm) == pytest.approx(reflectance, abs=0.0075)
    assert sheet.diffuse(nm) + sheet.gloss(nm) == pytest.approx(0.85 * reflectance, abs=0.0025)


def test_a_material_without_an_end_of_life_has_none() -> None:
    assert "diffuse_reference_eol" not in available()
    with pytest.raises(ValueError, match=r"'diffuse_reference_eol' is unknown.*\[end_of_life\]"):
        load("diffuse_reference_eol")


def test_a_users_own_file_is_loaded_by_its_path(tmp_path: Path) -> None:
    path = write(tmp_path, PAINT + RETRO + WORN)
    fresh, worn = load(path), load(path + END_OF_LIFE)
    assert fresh.name == path
    assert float(fresh.retro(850.0)) == 1.0
    assert float(worn.retro(850.0)) == 0.5
    assert worn.title == "mine, end of life"
    assert path not in available()


def test_an_edited_file_is_read_anew_and_has_another_fingerprint(tmp_path: Path) -> None:
    path = write(tmp_path, PAINT)
    before = load(path).diffuse(850.0), fingerprint(path)
    write(tmp_path, PAINT.replace("0.3", "0.4"))
    assert (load(path).diffuse(850.0), fingerprint(path)) == (0.4, fingerprint(path))
    assert before[0] == 0.3
    assert before[1] != fingerprint(path)
    assert fingerprint(path + END_OF_LIFE) != fingerprint(path)


def test_the_fingerprint_of_a_file_does_not_depend_on_where_it_lies(tmp_path: Path) -> None:
    assert fingerprint(write(tmp_path, PAINT, "a.toml")) == fingerprint(write(tmp_path, PAINT, "b.toml"))
    assert fingerprint("mli_foil") == "mli_foil"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (PAINT.replace("0.3", "31.4"), r"diffuse\.albedo: 31\.4, expected an albedo from 0 to 1"),
        (PAINT.replace("0.3", "-0.1"), r"diffuse\.albedo: -0\.1, expected"),
        (PAINT.replace("0.3", "nan"), r"diffuse\.albedo: nan, expected"),
        (PAINT.replace("0.3", "true"), r"diffuse\.albedo: True, expected"),
        (PAINT.replace("0.3", '"white"'), r"diffuse\.albedo: 'white', expected .*nm"),
        (PAINT.replace("0.3", "[[800, 0.1], [700, 0.2]]"), r"diffuse\.albedo: wavelengths .* must increase .*nm"),
        (PAINT.replace("0.3", "[[100, 0.1], [700, 0.2]]"), r"diffuse\.albedo: wavelengths .*300-1200 nm"),
        (PAINT.replace("albedo", "albdo"), r"diffuse\.albdo: unknown key, expected one of albedo"),
        (PAINT.replace('source = "my bench"\n', ""), r"source: missing, expected publication"),
        (HEAD, r"diffuse: missing"),
        (HEAD + "diffuse = 0.3\n", r"diffuse: 0\.3, expected a table"),
        (PAINT.replace("false", '"maybe"'), r"assumption: 'maybe', expected a valid boolean"),
        (PAINT + "[glos]\nalbedo = 0.1\n", r"glos: unknown key, expected one of .*gloss"),
        (PAINT + "[gloss]\nalbedo = 0.1\nggx_alpha = 0\n", r"gloss\.ggx_alpha: 0, .*0\.01 \(GGX roughness \[-\]\)"),
        (
            PAINT + RETRO.replace("[0.1, 0.5]", "[0.5, 0.1]"),
            r"retro\.observation_deg: \[0\.5, 0\.1\].*increase \[deg\]",
        ),
        (PAINT + RETRO.replace("30.0]", "95.0]"), r"retro\.entrance_deg\.1: 95\.0, expected less than 89.*\[deg\]"),
        (PAINT + RETRO.replace(", [40, 9]", ""), r"retro: coefficient_cd_per_lx_m2 .*expected 2 .* of 2 .*\[1/sr\]"),
        (PAINT + RETRO.replace("9]", "-9]"), r"retro\.coefficient_cd_per_lx_m2\.1\.1: -9, .*greater than 0 .*1/sr"),
        (PAINT + RETRO + "tail_exponent = 1.5\n", r"retro\.tail_exponent: 1\.5, expected greater than 2"),
        (PAINT + WORN.replace("0.5", "-1"), r"end_of_life\.retro: -1, expected greater than or equal to 0"),
        ("title = = 3", r"not a TOML file"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line_with_key_value_and_unit(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(ValueError, match=rf"^material .*mine\.toml: {line}") as refusal:
        load(write(tmp_path, text))
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.toml' cannot be read \(No such file"):
        load(str(tmp_path / "none.toml"))


def test_the_widest_top_hat_of_a_height() -> None:
    """f₀ π sin²θ ≤ share: the audit's 2.29 and 1.45 deg, and 1.74 deg for a return of 58 percent."""
    assert widest_half_angle_deg(200.0) == pytest.approx(2.29, abs=0.005)
    assert widest_half_angle_deg(500.0) == pytest.approx(1.45, abs=0.005)
    assert widest_half_angle_deg(200.0, 0.58) == pytest.approx(1.74, abs=0.005)
    assert widest_half_angle_deg(0.1) == 90.0


def test_a_flat_lobe_of_200_per_steradian_is_refused_with_the_arithmetic(tmp_path: Path) -> None:
    flat = RETRO.replace("[0.1, 0.5]", "[0.1, 90.0]").replace("[[90, 20], [40, 9]]", "[[200, 200], [200, 200]]")
    with pytest.raises(ValueError, match="conserves energy") as refusal:
        load(write(tmp_path, HEAD + "[diffuse]\nalbedo = 0\n" + flat))
    line = str(refusal.value)
    assert "at 0 deg and 850 nm" in line
    assert "A lobe of 200 /sr" in line
    assert "f0 * pi * sin^2(angle) <= 1 allows 2.29 deg" in line


def test_ageing_that_makes_light_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, PAINT + WORN.replace("retro = 0.5", "diffuse = 4.0"))
    load(path)
    with pytest.raises(ValueError, match=r"returns 1\.2 times .*\(diffuse 1\.2\)"):
        load(path + END_OF_LIFE)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    st.lists(st.floats(300, 1200), min_size=2, max_size=8, unique=True).map(sorted),
    st.lists(st.floats(0, 1), min_size=8, max_size=8),
    st.floats(300, 1200),
)
def test_a_spectral_table_is_interpolated_and_held_at_its_ends(
    grid: list[float], values: list[float], nm: float
) -> None:
    rows = ", ".join(f"[{w!r}, {v!r}]" for w, v in zip(grid, values, strict=False))
    spectrum = parse(HEAD + f"[diffuse]\nalbedo = [{rows}]\n", "table").diffuse.albedo
    assert spectrum(nm) == pytest.approx(np.interp(nm, grid, values[: len(grid)]), abs=1e-9)


def test_a_users_own_tape_reaches_the_renderer_even_at_a_slope_of_minus_two(mi: ModuleType, tmp_path: Path) -> None:
    """Between 0.1 and 0.2 deg this table falls as α^-2, whose integral is a logarithm."""
    text = PAINT + RETRO.replace("[0.1, 0.5]", "[0.1, 0.2]").replace("[90, 20], [40, 9]", "[400, 100], [400, 100]")
    path = write(tmp_path, text)
    bsdf = mi.load_dict({"type": "mantis_material", "material": path})
    count = 200_000
    one, x, y = np.random.default_rng(5).random((3, count), dtype=np.float32)
    si = mi.SurfaceInteraction3f()
    si.wi, si.t = mi.Vector3f(0.0, 0.0, 1.0), mi.Float(1.0)
    si.wavelengths = mi.Spectrum(850.0)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(one), mi.Point2f(mi.Float(x), mi.Float(y)), True)
    weights = np.array(weight[0], float)
    # 99.9 % interval of a mean, and the error of the 400-node rule.
    assert weights.mean() == pytest.approx(load(path).albedo(0.0, 850.0), abs=3.3 * weights.std() / count**0.5 + 2e-4)
