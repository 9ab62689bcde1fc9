"""What thesis sections 7.1 and 8.2 and listing A.3 state, beside what comes of the emulated laboratory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from experiments.reporting.formatting import number
from experiments.scenario import Scenario
from experiments.studies.shared.judge import WRONG_CORNER
from experiments.thesis.claims import Claim
from experiments.thesis.physical import arm
from experiments.thesis.physical.camera import Calibrated, solved
from experiments.thesis.physical.study import PhysicalResult
from experiments.thesis.physical.summary import beside, frontal, mean, outliers, rms, series
from radiometry.sources import am0_spectrum
from radiometry.spectrum import Spectrum

NAN = float("nan")
#: Bands whose ratio tells how alike two lights are [nm]: the longpass's up to where silicon ends, and the visible.
_NEAR_INFRARED, _VISIBLE = (715.0, 1000.0), (400.0, 700.0)
#: Largest mean error with which listing A.3 accepts a calibration [px].
_ACCEPTED_PX = 1.0

#: Why this project's virtual points may add little to its corners.
_LITTLE_ADDED = "; right: a fitted pattern, in frames whose noise is averaged, leaves the virtual points little to add"


def claims(result: PhysicalResult) -> list[Claim]:
    """What the text states, beside the thesis's pipeline and this project's on the same frames."""
    frames = result.frames
    return [
        *_equipment(result.scenario, result.camera),
        *_full(frames, _ring_px(result)),
        *_scaled(frames),
        *_lamp(frames),
    ]


def _agrees(holds: bool) -> str:
    return "agrees" if holds else "disagrees"


def _equipment(scenario: Scenario, camera: Calibrated) -> Iterator[Claim]:
    """Section 7.1 and listing A.3."""
    real, marker = scenario.camera, scenario.marker
    side_mm = 1e3 * float(np.sqrt(real.width_px * real.height_px * real.pixel_area_m2))
    yield Claim(
        "eq. 7.2",
        "side of the detector",
        "mm",
        "18.43",
        side_mm,
        side_mm,
    )
    field = 2 * np.degrees(np.arctan(side_mm / 2e3 / real.focal_length_m))
    known = solved(real, camera.found)
    middle = known.principal_point_px[1]
    ends = np.array([[-0.5, middle], [real.width_px - 0.5, middle]])
    tangents = (known.undistort_px(ends)[:, 0] - known.principal_point_px[0]) / known.focal_px[0]
    seen = float(np.degrees(np.arctan(tangents[1]) - np.arctan(tangents[0])))
    yield Claim(
        "eq. 7.3",
        "field of view at 24 mm",
        "°",
        "42.01",
        float(field),
        seen,
        remark="right: of the calibrated camera, whose barrel distortion (assumed) widens it",
    )
    for what, printed, value in (
        ("length", "100", marker.element_length_m),
        ("width", "20", marker.element_width_fraction * marker.aruco_m),
        ("depth", "10", marker.element_depth_m),
    ):
        yield Claim(
            "sec. 7.1.3",
            f"{what} of an element's opening",
            "mm",
            printed,
            NAN,
            1e3 * value,
            remark="by the listing's factors",
        )
    leds = scenario.leds
    told = arm.table()["leds"]
    yield Claim(
        "sec. 7.1.2",
        "electrical power of the LEDs",
        "W",
        "",
        told["supply_v"] * told["supply_a"],
        leds.count * leds.electrical_power_w,
        remark=f"8.8 V × 2 A: {leds.count} LEDs of {leds.electrical_power_w:.2f} W; chapter 6 counts on 100",
    )
    lamp = arm.equipped(scenario).sun.irradiance()
    suns = am0_spectrum()
    level = _band(lamp, _NEAR_INFRARED) / _band(suns, _NEAR_INFRARED)
    yield Claim(
        "sec. 7.1.2",
        "715–1000 nm over 400–700 nm, halogen over Sun",
        "1",
        "1",
        NAN,
        _band(lamp, _NEAR_INFRARED) / _band(lamp, _VISIBLE) / (_band(suns, _NEAR_INFRARED) / _band(suns, _VISIBLE)),
        remark="disagrees: a lamp that a light meter calls as bright as the Sun is so many times brighter to this camera",
    )
    yield Claim(
        "sec. 7.1.2",
        "halogen's irradiance at 715–1000 nm over the Sun's",
        "1",
        "",
        NAN,
        level,
        remark=f"level assumed: {arm.table()['lamp']['illuminance_lx']:,.0f} lx, {_band(lamp, _NEAR_INFRARED):.0f} W/m² in that "
        "band",
    )
    yield Claim(
        "listing A.3",
        "mean reprojection error that is accepted",
        "px",
        "< 1",
        camera.listing_error_px,
        camera.found.rms_px,
        remark=(
            f"the listing takes the root of a mean of distances of whole views, which is no distance of a corner: its corners "
            f"are {number(camera.listing_rms_px)} px off, and a good calibration "
            f"{'fails' if camera.listing_error_px > _ACCEPTED_PX else 'passes'}. Right: rms of this project's corners"
        ),
    )
    yield Claim(
        "listing A.3",
        "focal length, found over true",
        "1",
        "",
        float(camera.listing.focal_px[0] / real.focal_px[0]),
        float(camera.found.focal_px[0] / real.focal_px[0]),
        remark=(
            f"± {number(float(camera.listing.sigma[0] / real.focal_px[0]))} and ± "
            f"{number(float(camera.found.sigma[0] / real.focal_px[0]))}"
        ),
    )


def _band(spectrum: Spectrum, band_nm: tuple[float, float]) -> float:
    fine = spectrum.resampled(1.0)
    inside = (fine.wavelength_nm >= band_nm[0]) & (fine.wavelength_nm <= band_nm[1])
    return float(np.trapezoid(fine.values[inside], fine.wavelength_nm[inside]))


def _full(frames: xr.Dataset, ring_px: float) -> Iterator[Claim]:
    """Figure 8.11: frames as taken, in eclipse; `ring_px` as `_ring_px`."""
    own, bare, listed, listed_bare = (
        series(frames, "eclipse", "full", by) for by in ("mantis", "inner", "thesis", "thesis_inner")
    )
    yield Claim(
        "sec. 7.1.4",
        "one-way passes of a run",
        "1",
        "8",
        NAN,
        float(frames.sizes["passing"] * frames.sizes["way"]),
        remark="four heights there and back; section 8.2 shows three of them",
    )
    turns = _turns(np.abs(own.yaw_deg.isel(passing=0)))
    yield Claim(
        "fig. 8.11",
        "turning points of |yaw| in a pass there and back",
        "1",
        "3 (a W)",
        NAN,
        float(turns),
        remark=(
            "the sign of yaw changes once each way, and its size traces a W: the thesis's plot has the size, or its arm "
            "turned otherwise"
        ),
    )
    apart = (rms(listed.yaw_deg - listed_bare.yaw_deg), rms(own.yaw_deg - bare.yaw_deg))
    share = 100 * mean(listed.virtual)
    yield Claim(
        "fig. 8.11",
        "yaw of Mantis less yaw of its inner ArUco, rms",
        "°",
        "nearly 0",
        *apart,
        remark=(
            f"{_agrees(apart[0] < 1)}; the thesis's pipeline has a virtual point in {share:.0f} % of the frames, and "
            "elsewhere gives the inner ArUco's pose itself: that both agree says little"
        ),
    )
    yield Claim(
        "fig. 8.11",
        "ambiguous poses of the inner ArUco (off by over 10°)",
        "frames",
        "0",
        float(outliers(listed_bare).sum()),
        float(outliers(bare).sum()),
        remark=_mirrored(listed_bare),
    )
    near = frontal(frames)
    for by, what in (("thesis", "AprilTag refinement, as listed"), ("window_inner", "refinement in a window")):
        method = series(frames, "eclipse", "full", by)
        scaled = series(frames, "eclipse", "scaled", by)
        found = 100 * mean(method.wrong_corners, near)
        yield Claim(
            "sec. 8.2",
            f"wrong corners near frontal, {what}",
            "%",
            "some",
            found,
            100 * mean(own.wrong_corners, near),
            remark=(
                f"{_agrees(found > 0)}; {number(100 * mean(method.wrong_corners))} % over all stations: the narrow ring's outer "
                f"corner is {number(2 * ring_px)} px off where the arm is nearest, and nearer where the ring is seen from aside; "
                f"near frontal in scaled frames {number(100 * mean(scaled.wrong_corners, near))} %"
            ),
        )
    errors = (rms(listed.yaw_error_deg), rms(own.yaw_error_deg))
    yield Claim(
        "fig. 8.11",
        "yaw error of Mantis, rms",
        "°",
        "",
        *errors,
        remark="the thesis has no truth beside it",
    )
    errors = (rms(listed_bare.yaw_error_deg), rms(bare.yaw_error_deg))
    yield Claim(
        "fig. 8.11",
        "yaw error of its inner ArUco, rms",
        "°",
        "",
        *errors,
    )


def _mirrored(frames: xr.Dataset) -> str:
    """Whether there are no outliers, or how far from squarely they are."""
    wild = outliers(frames)
    if not wild.any():
        return _agrees(True)
    off = float(np.abs(frames.true_yaw_deg).where(wild.any("way")).max())
    return f"{_agrees(False)}: yaw within {off:.0f}° of squarely seen, where the mirrored pose of a square fits nearly as well"


def _ring_px(result: PhysicalResult) -> float:
    """From the middle of the narrow ring's diagonal to its ends where the arm is nearest [px]."""
    scenario, nearest_m = result.scenario, float(result.frames.range_m.min())
    return float(WRONG_CORNER * scenario.marker.aruco_m * max(scenario.camera.focal_px) / nearest_m)


def _turns(values: xr.DataArray) -> int:
    """Turning points of a curve over the frames of a pass there and back, smoothed over a tenth of a pass."""
    out, back = values.sel(way="out").values, values.sel(way="back").values[::-1]
    curve = np.concatenate([out, back])
    width = max(1, len(out) // 10)
    smooth = np.convolve(np.nan_to_num(curve), np.ones(width) / width, mode="valid")
    step = np.diff(smooth)
    sign = np.sign(step[np.abs(step) > 1e-9])
    return int(np.count_nonzero(np.diff(sign)))


def _scaled(frames: xr.Dataset) -> Iterator[Claim]:
    """Figure 8.12: the same, scaled as in section 7.1.5."""
    own, bare, listed, listed_bare = (
        series(frames, "eclipse", "scaled", by) for by in ("mantis", "inner", "thesis", "thesis_inner")
    )
    near = frontal(frames)
    flips = float(outliers(listed_bare).sum())
    yield Claim(
        "fig. 8.12",
        "ambiguous poses of the inner ArUco (off by over 10°)",
        "frames",
        "some",
        flips,
        float(outliers(bare).sum()),
        remark=f"{_agrees(flips > 0)}; right tries both minima, with corners of a fitted pattern",
    )
    wild = float(outliers(listed).sum())
    yield Claim(
        "fig. 8.12",
        "ambiguous poses of Mantis",
        "frames",
        "0",
        wild,
        float(outliers(own).sum()),
        remark=_agrees(wild == 0)
        + (": without a virtual point the pipeline gives the inner ArUco's pose" if wild else ""),
    )
    listed_ratio, ratio = (
        rms(flat.yaw_error_deg.where(near)) / rms(all_of.yaw_error_deg.where(near))
        for flat, all_of in ((listed_bare, listed), (bare, own))
    )
    yield Claim(
        "fig. 8.12",
        "yaw rms within 10° of frontal, inner ArUco over Mantis",
        "1",
        "≫ 1",
        listed_ratio,
        ratio,
        remark=_agrees(listed_ratio > 2) + ("" if ratio > 2 else _LITTLE_ADDED),
    )
    found = (100 * mean(listed.found), 100 * mean(own.found))
    yield Claim(
        "fig. 8.12",
        "scaled frames in which the marker is found",
        "%",
        "",
        *found,
        remark="OpenCV decodes from some 3 px a bit on",
    )
    errors = (rms(listed.yaw_error_deg), rms(own.yaw_error_deg))
    yield Claim(
        "fig. 8.12",
        "yaw error of Mantis, rms",
        "°",
        "",
        *errors,
    )


def _with_blob(frames: xr.Dataset, chosen: xr.DataArray) -> float:
    """Share of the chosen frames with a blob, of those that show the marker [%]."""
    return 100 * mean((frames.blobs_found > 0).astype(float), chosen & (frames.found > 0))


def _lamp(frames: xr.Dataset) -> Iterator[Claim]:
    """Figure 8.13: the run under the lamp."""
    for name, printed in (("beside the camera", "found"), ("aside", "none")):
        chosen = beside(frames) if printed == "found" else ~beside(frames)
        listed_share, share = (_with_blob(series(frames, "sunlit", "full", by), chosen) for by in ("thesis", "mantis"))
        dark = _with_blob(series(frames, "eclipse", "full", "thesis"), chosen)
        yield Claim(
            "fig. 8.13",
            f"frames with a blob, lamp {name}",
            "%",
            printed,
            listed_share,
            share,
            remark=f"{_agrees((listed_share > 50) == (printed == 'found'))}; {dark:.0f} % in eclipse at the same stations",
        )
    filled = arm.table()["exposure"]["full_well_fraction"]
    exposure = float(frames.exposure_s.sel(illumination="sunlit") / frames.exposure_s.sel(illumination="eclipse"))
    yield Claim(
        "sec. 8.2",
        "brightness of a blob under the lamp over that in eclipse",
        "1",
        "greatly reduced",
        exposure,
        exposure,
        remark=(
            "the exposure follows the bits, which the lamp lights as well; the lamp does not reach a slit's floor from aside. "
            f"Both exposures fill {100 * filled:.0f} % of the well with the bits squarely seen"
        ),
    )
    listed, own, bare, pair = (series(frames, "sunlit", "full", by) for by in ("thesis", "mantis", "inner", "pair"))
    for name, chosen in (("beside the camera", beside(frames)), ("aside", ~beside(frames))):
        alone, paired = (number(rms(one.yaw_error_deg.where(chosen))) for one in (bare, pair))
        yield Claim(
            "sec. 8.2",
            f"yaw error of Mantis under the lamp, {name}, rms",
            "°",
            "",
            rms(listed.yaw_error_deg.where(chosen)),
            rms(own.yaw_error_deg.where(chosen)),
            remark=(
                f"by its inner ArUco alone {alone}°: what the lamp lights on the slits' floors moves the blobs. From differences "
                f"of frames with and without the LEDs: {paired}°"
            ),
        )
