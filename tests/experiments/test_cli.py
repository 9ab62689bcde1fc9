"""Exit status and messages of the command line: one clear line for every mistake, and nothing half-written."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from experiments import chain
from experiments.cli.options import BAD_INPUT, REQUIREMENT_NOT_MET
from experiments.reporting.files import write_png
from experiments.scenario import Scenario
from scenes.files import exr
from scenes.render import batch
from scenes.render.transport import TransportBasis

Mantis = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def desk(
    tmp_path_factory: pytest.TempPathFactory, small: Scenario, small_basis: TransportBasis, small_file: Path
) -> Path:
    """A folder with good files and every kind of bad one."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "small.toml").write_bytes(small_file.read_bytes())
    exr.write_basis(small_basis, folder / "basis.exr")
    frame = chain.expose(small, chain.electron_rate(small, small_basis, "eclipse"), "eclipse", 5e-7)
    write_png(frame.dn, folder / "frame.png")

    (folder / "folder").mkdir()
    (folder / "folder.exr").mkdir()
    (folder / "folder.png").mkdir()
    (folder / "file").write_text("a file where a folder is wanted")
    for name in ("empty.png", "empty.exr", "empty.json"):
        (folder / name).touch()
    for name in ("text.png", "text.exr"):
        (folder / name).write_text("not an image")
    (folder / "short.png").write_bytes((folder / "frame.png").read_bytes()[:2000])
    for name, length in (("short.exr", 6000), ("shorter.exr", 200)):
        (folder / name).write_bytes((folder / "basis.exr").read_bytes()[:length])
    write_png(np.zeros((48, 64), np.uint16), folder / "size.png")
    side = small.camera.width_px
    exr.write_channels({"Y": np.full((side, side), np.nan, np.float32)}, {}, folder / "nan.exr")
    exr.write_channels({"Y": np.zeros((side, side), np.float32)}, {}, folder / "grey.exr")

    nodes, layers = small_basis.nodes_nm, small_basis.layers
    bad = layers["sun"].copy()
    bad[1, 3, 3] = np.nan
    exr.write_basis(TransportBasis(nodes, {**layers, "sun": bad}), folder / "nan_basis.exr")
    exr.write_basis(TransportBasis(nodes, {k: -v for k, v in layers.items()}), folder / "negative.exr")
    exr.write_basis(TransportBasis(nodes, {k: v[:, :48] for k, v in layers.items()}), folder / "cropped.exr")
    exr.write_basis(TransportBasis(nodes[:2], {k: v[:2] for k, v in layers.items()}), folder / "two_nodes.exr")
    exr.write_basis(TransportBasis((600, 610, 620, 630), layers), folder / "visible.exr")
    exr.write_channels({"led.nm0850": layers["led"][0]}, {}, folder / "led_only.exr")

    (folder / "broken.toml").write_text("leds = = 3")
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (folder / "twice.toml").write_text("[leds]\ncount = 1\n[leds]\ncount = 2\n")
    (folder / "flat.toml").write_text("leds = 3")
    (folder / "typo.toml").write_text("[camera]\nf_nubmer = 2\n")
    return folder


RENDER = ("render", "small.toml", "-o", "new.exr")
EXPOSE = ("expose", "basis.exr", "small.toml", "-o", "new.png")
DETECT = ("detect", "frame.png", "small.toml")


def set_(key_value: str, *command: str) -> tuple[str, ...]:
    return (*(command or RENDER), "--set", key_value)


#: Command line -> what its one line must say.
MISTAKES: list[tuple[tuple[str, ...], str]] = [
    # no such verb, option or argument
    (("frobnicate",), "No such command 'frobnicate'"),
    (("sensor",), "Missing command"),
    (("budget", "--fast"), "No such option '--fast'"),
    (("expose",), "Missing argument"),
    (("detect",), "Missing argument"),
    ((*EXPOSE, "more"), "unexpected extra argument"),
    ((*RENDER, "--seed", "-1"), "--seed"),
    ((*RENDER, "--seed", "x"), "--seed"),
    ((*RENDER, "--seed", str(2**63)), "seed: 9223372036854775808, expected less than"),
    ((*EXPOSE, "--trial", "-1"), "--trial"),
    ((*DETECT, "--require", "beauty"), "--require"),
    (("budget", "--workers", "-1"), "--workers"),
    (("budget", "--require", "soon"), "expected 'closes' or ILLUMINATION:RANGE"),
    (("budget", "--require", "dusk:3"), "expected 'closes' or ILLUMINATION:RANGE"),
    (("budget", "--require", "eclipse:nan"), "expected 'closes' or ILLUMINATION:RANGE"),
    (("budget", "--require", "eclipse:25"), "judges 1 to 20 m only"),
    (("budget", "--require", "sunlit:0.5"), "judges 1 to 20 m only"),
    # --set
    (set_("leds.count"), "--set leds.count: expected key=value"),
    (set_("=3"), "--set =3: expected key=value"),
    (set_("range_m.near=3"), "range_m holds a value, not keys"),
    (set_("leds.cuont=3"), "leds.cuont: unknown key; did you mean 'leds.count' (number of LEDs"),
    (set_("led.count=3"), "led: unknown key; did you mean 'leds'?"),
    (set_("rnage_m=3"), "rnage_m: unknown key; did you mean 'range_m' (camera to marker along the optical axis [m])?"),
    (set_("qqq=3"), "qqq: unknown key"),
    # types and ranges, with the unit
    (set_("range_m=near"), "range_m: 'near', expected a valid number (camera to marker along the optical axis [m])"),
    (set_("range_m=-1"), "range_m: -1, expected greater than or equal to 0.05"),
    (set_("range_m=nan"), "range_m: nan, expected a finite number"),
    (set_("range_m=inf"), "range_m: inf, expected a finite number"),
    (set_("exposure_s=-1"), "exposure_s: -1, expected greater than 0 (exposure and LED pulse [s], or 'auto')"),
    (set_("exposure_s=automatic"), "exposure_s: 'automatic'"),
    (set_("exposure_s=nan"), "exposure_s: nan, expected a finite number"),
    (set_("illumination=dusk"), "illumination: 'dusk', expected 'eclipse' or 'sunlit'"),
    (set_("leds.count=1.5"), "leds.count: 1.5, expected a valid integer"),
    (set_("leds=3"), "leds: 3, expected"),
    (set_('title=["a", "b"]'), "title: ['a', 'b'], expected a valid string"),
    (set_("camera.psf_sigma_px=nan"), "camera.psf_sigma_px: nan, expected"),
    (set_("camera.width_px=4"), "camera.width_px: 4, expected greater than or equal to 16"),
    (set_("sun.phase_deg=nan"), "sun.phase_deg: nan, expected"),
    (set_("target.pitch_deg=nan"), "target.pitch_deg: nan, expected"),
    (set_("target.facet_m=inf"), "target.facet_m: inf, expected a finite number"),
    (set_("filter.edge_nm=nan"), "filter.edge_nm: nan, expected"),
    (set_("render.wavelength_nodes=5"), "render.wavelength_nodes: 5, expected a multiple of 4"),
    (set_("budget.ranges_m=[2, 1]"), "ranges_m: must increase"),
    (set_("budget.ranges_m=[]"), "budget.ranges_m: [], expected at least one value (ranges [m]"),
    # millimetres and micrometres for metres
    (
        set_("camera.focal_length_m=35"),
        "camera.focal_length_m: 35, expected less than or equal to 10 (focal length [m])",
    ),
    (set_("camera.pixel_pitch_x_m=3.45"), "camera.pixel_pitch_x_m: 3.45, expected less than or equal to 0.001"),
    (set_("leds.ring_radius_m=50"), "leds.ring_radius_m: 50, expected less than or equal to 25"),
    (set_('budget.illuminations=["dusk"]'), "'dusk', expected 'eclipse' or 'sunlit'"),
    (set_("sensor.quantum_efficiency=2"), "sensor.quantum_efficiency: 2, expected"),
    (set_("sensor.quantum_efficiency=[[800, 0.3], [700, 0.3]]"), "wavelengths [nm] must increase"),
    (set_("sensor.preset=kodak"), "sensor.preset: 'kodak' is unknown; expected one of"),
    # what does not fit together
    (set_("marker.element_width_fraction=0.9"), "elements reach 0.824 of the marker's side"),
    (set_("marker.size_m=2"), "marker.size_m: 2 m exceeds target.face_m, 1 m"),
    (set_("marker.dictionary=9X9"), "'9X9' is not one of OpenCV's"),
    (set_("leds.intensity_w_sr=100"), "19.4 W of light"),
    (set_("target.face_material=cheese"), "target.face_material: "),
    (set_("target.facet_m=1e-6"), "facet_m: 1e-06 m is 1000000 facets along face_m"),
    (set_("filter.high_nm=700"), "high_nm: 700 nm must exceed low_nm 800 nm"),
    (
        ("render", "small.toml", "-o", "new.exr", "--set", "filter.low_nm=850", "--set", "filter.high_nm=851"),
        "too narrow",
    ),
    (set_("sensor.offset_dn=5000"), "offset_dn 5000: must be below the largest number, 4095 DN"),
    # scenario files
    (("render", "none.toml", "-o", "new.exr"), "none.toml: no such scenario file; shipped: default"),
    (("render", "folder", "-o", "new.exr"), "folder: a folder, no scenario file"),
    (("render", "broken.toml", "-o", "new.exr"), "broken.toml: not a TOML file (Invalid value (at line 1"),
    (("render", "binary.toml", "-o", "new.exr"), "binary.toml: not a TOML file"),
    (("render", "twice.toml", "-o", "new.exr"), "twice.toml: not a TOML file"),
    (("render", "flat.toml", "-o", "new.exr"), "leds: 3, expected"),
    (("render", "typo.toml", "-o", "new.exr"), "camera.f_nubmer: unknown key; did you mean 'camera.f_number'"),
    # where to write
    (("render", "small.toml"), "give --out FILE.exr, --export FOLDER, or both"),
    (("render", "small.toml", "-o", "new.png"), "expected a name that ends in .exr"),
    (("render", "small.toml", "-o", "file/new.exr"), "file"),
    (("render", "small.toml", "--export", "file"), "'file' is a file"),
    (("expose", "basis.exr", "small.toml"), "give --out FILE.png"),
    (("expose", "basis.exr", "small.toml", "-o", "new.jpg"), "give --out FILE.png"),
    (("expose", "basis.exr", "small.toml", "-o", "file/new.png"), "file"),
    (("expose", "basis.exr", "small.toml", "-o", "folder.png"), "folder.png: Is a directory"),
    (("expose", "basis.exr", "small.toml", "-o", "folder.exr"), "folder.exr: Is a directory"),
    ((*DETECT, "-o", "file/new.json"), "file"),
    ((*DETECT, "-o", "folder"), "folder: Is a directory"),
    (("budget", "small.toml", "-o", "file"), "--out file: cannot be made a folder"),
    (("budget", "small.toml", "-o", "file/new"), "--out file/new: cannot be made a folder"),
    (("schema", "-o", "file/new.json"), "file"),
    (("marker",), "give --out FOLDER"),
    (("marker", "-o", "file"), "file"),
    (("sensor", "emva1288"), "give --out FOLDER"),
    (("sensor", "emva1288", "-o", "file"), "file"),
    (("sensor", "emva1288", "-o", "new", "--preset", "kodak"), "--preset kodak: unknown; there are"),
    # a transport basis
    (("expose", "none.exr", "small.toml", "-o", "new.png"), "none.exr: no such file"),
    (("expose", "folder.exr", "small.toml", "-o", "new.png"), "folder.exr: no such file"),
    (("expose", "text.exr", "small.toml", "-o", "new.png"), "text.exr: not a readable OpenEXR file"),
    (("expose", "empty.exr", "small.toml", "-o", "new.png"), "empty.exr: not a readable OpenEXR file"),
    (("expose", "short.exr", "small.toml", "-o", "new.png"), "short.exr: not a readable OpenEXR file"),
    (("expose", "shorter.exr", "small.toml", "-o", "new.png"), "shorter.exr: not a readable OpenEXR file"),
    (("expose", "frame.png", "small.toml", "-o", "new.png"), "frame.png: not a readable OpenEXR file"),
    (("expose", "grey.exr", "small.toml", "-o", "new.png"), "grey.exr: layers Y; expected led.nmNNNN and sun.nmNNNN"),
    (("expose", "led_only.exr", "small.toml", "-o", "new.png"), "led_only.exr: layers led.nm0850; expected"),
    (
        ("expose", "nan_basis.exr", "small.toml", "-o", "new.png"),
        "layer sun holds NaN, infinite or negative radiance [sr-1]",
    ),
    (("expose", "negative.exr", "small.toml", "-o", "new.png"), "holds NaN, infinite or negative radiance"),
    (("expose", "cropped.exr", "small.toml", "-o", "new.png"), "160 × 48 px, the camera 160 × 160 px"),
    (("expose", "two_nodes.exr", "small.toml", "-o", "new.png"), "expected four or more that span the passband"),
    (("expose", "visible.exr", "small.toml", "-o", "new.png"), "layers at 600, 610, 620, 630 nm; expected"),
    (set_("range_m=5", *EXPOSE), "rendered from another geometry (range 3 m, the scenario has 5 m"),
    (set_("sun.phase_deg=30", *EXPOSE), "basis.exr: rendered from another geometry"),
    # an image
    (("detect", "none.png", "small.toml"), "none.png: no such file"),
    (("detect", "folder.png", "small.toml"), "folder.png: no such file"),
    (("detect", "text.png", "small.toml"), "text.png: not an image"),
    (("detect", "empty.png", "small.toml"), "empty.png: not an image"),
    (("detect", "short.png", "small.toml"), "short.png: not an image"),
    (("detect", "text.exr", "small.toml"), "text.exr: not a readable OpenEXR file"),
    (("detect", "size.png", "small.toml"), "image is 64×48 px, the camera 160×160 px"),
    (("detect", "nan.exr", "small.toml"), "nan.exr: holds NaN or infinite pixels"),
    ((*DETECT, "--off", "none.png"), "none.png: no such file"),
    ((*DETECT, "--off", "size.png"), "off: 64×48 px of"),
    # the other verbs' files
    (("requirements", "--results", "none", "-o", "new"), "--results none: no such folder"),
    (("close", "flat.toml", "--no-render", "-o", "new"), "leds: unknown key"),
    (("sweep", "none.toml", "-o", "new.nc"), "none.toml"),
    (("sweep", "broken.toml", "-o", "new.nc"), "broken.toml"),
    (("sweep", "small.toml", "-o", "new.nc"), "small.toml"),
    (("sweep", "small.toml"), "give --out FILE.nc"),
    (("plot", "none.nc", "--x", "range_m", "--y", "cnr_analytic", "-o", "new.svg"), "none.nc"),
    (("plot", "text.png", "--x", "range_m", "--y", "cnr_analytic", "-o", "new.svg"), "text.png"),
    (("plot", "text.png", "--y", "cnr_analytic", "-o", "new.svg"), "Missing option '--x'"),
    (("materials", "cheese"), "cheese"),
    (("errata", "--set", "leds.count=3"), "--set"),
]


def contents(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(p.relative_to(folder)): (p.stat().st_mtime_ns, p.stat().st_size) for p in folder.rglob("*")}


@pytest.mark.parametrize(("command", "says"), MISTAKES, ids=[" ".join(c)[:80] for c, _ in MISTAKES])
def test_a_mistake_is_told_in_one_line_and_changes_nothing(
    mantis: Mantis, desk: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], says: str
) -> None:
    monkeypatch.chdir(desk)
    monkeypatch.setattr(batch, "trace", lambda *_: pytest.fail("rendered before the mistake was found"))
    before = contents(desk)
    status, out, error = mantis(*command)
    assert (status, out) == (BAD_INPUT, "")
    assert error.startswith("mantis: ")
    assert says in error
    assert error.count("\n") == 1
    assert error.endswith("\n")
    assert contents(desk) == before


def test_without_a_word_the_command_says_what_there_is(mantis: Mantis) -> None:
    status, out, error = mantis()
    assert (status, error) == (0, "")
    assert "budget" in out


@pytest.mark.parametrize("wanted", ["detected", "pose"])
def test_a_requirement_that_is_not_met_ends_with_status_4(
    mantis: Mantis, desk: Path, monkeypatch: pytest.MonkeyPatch, wanted: str
) -> None:
    monkeypatch.chdir(desk)
    status, out, error = mantis("detect", "grey.exr", "small.toml", "--json", "--require", wanted)
    assert status == REQUIREMENT_NOT_MET
    assert error == f"mantis: required: {wanted}, but {json.loads(out)['reason']}\n"
    assert mantis("detect", "grey.exr", "small.toml", "--quiet") == (0, "", "")
    assert mantis(*DETECT, "--quiet", "--require", wanted) == (0, "", "")


def test_colour_and_eight_bits_are_read_as_luminance(mantis: Mantis, desk: Path, tmp_path: Path) -> None:
    grey = cv2.imread(str(desk / "frame.png"), cv2.IMREAD_UNCHANGED)
    eight = np.clip(grey / grey.max() * 255, 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "colour.png"), cv2.cvtColor(eight, cv2.COLOR_GRAY2BGR))
    status, out, _ = mantis("detect", tmp_path / "colour.png", desk / "small.toml", "--json")
    assert status == 0
    assert json.loads(out)["detected"]


@pytest.mark.parametrize("interrupt", [KeyboardInterrupt, OSError(28, "No space left on device")])
@pytest.mark.parametrize("out", ["kept.png", "kept.exr", "new.png", "new.exr"])
def test_an_interrupted_write_leaves_the_old_file_and_no_other(
    mantis: Mantis, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interrupt: BaseException, out: str
) -> None:
    for name in ("kept.png", "kept.exr"):
        (tmp_path / name).write_text("earlier result")

    def half(path: Path | str, *_: object) -> bool:
        Path(path).write_bytes(b"half")
        raise interrupt

    import OpenEXR

    monkeypatch.setattr("experiments.reporting.files.cv2.imwrite", half)
    monkeypatch.setattr(OpenEXR.File, "write", lambda _self, path: half(path))
    status, _, error = mantis("expose", desk / "basis.exr", desk / "small.toml", "-o", tmp_path / out)
    assert status == (130 if interrupt is KeyboardInterrupt else BAD_INPUT)
    message = error.lstrip("\n")  # an interrupt leaves the line on which the terminal shows ^C
    assert message.startswith("mantis: ")
    assert message.count("\n") == 1
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == dict.fromkeys(
        ("kept.png", "kept.exr"), "earlier result"
    )


def test_quiet_and_json_print_nothing_else(mantis: Mantis, desk: Path, tmp_path: Path) -> None:
    command = ("expose", desk / "basis.exr", desk / "small.toml", "-o", tmp_path / "frame.png")
    assert mantis(*command, "--quiet") == (0, "", "")
    status, out, error = mantis(*command, "--json")
    assert (status, error) == (0, "")
    assert json.loads(out)["illumination"] == "eclipse"
    assert mantis(*command)[1].startswith("eclipse, ")


def test_the_schema_is_json_and_describes_every_section(mantis: Mantis, tmp_path: Path) -> None:
    status, out, _ = mantis("schema")
    assert status == 0
    assert set(json.loads(out)["properties"]) == set(Scenario.model_fields)
    assert mantis("schema", "-o", tmp_path / "schema.json")[0] == 0
    assert json.loads((tmp_path / "schema.json").read_text(encoding="utf-8")) == json.loads(out)
