"""Calibrations from images: a marker's elements, and a camera by a chessboard; and both tried on rendered frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector.calibration.camera import CameraCalibration, calibrate_camera, chessboard_corners
from detector.calibration.elements import ElementCalibration, KnownPose, calibrate_elements
from detector.features import Features
from detector.sensor.sensor import expose
from experiments import chain
from experiments.scenario import Scenario
from experiments.scenario.toml import toml_text
from experiments.studies.shared.frames import MARGIN_PX, around_marker
from radiometry.geometry import FloatArray
from scenes.chessboard import Chessboard, view_of
from scenes.marker import ELEMENT_NAMES, MarkerDesign
from scenes.render.transport import Quality, render_bases

#: Calibrate, find the features again with the calibrated marker, calibrate: the blob model needs to know where the slits are.
#: Passes at most, and the change, over the standard deviation, that ends them.
PASSES, SETTLED_SIGMA = 8, 0.1
#: Steepest that the next result may depend on the marker of the last: -1 where the camera resolves the slits.
STEEPEST = 3.0
#: Phases of the slits that are tried first, in slit pitches: a blob whose slits are resolved half a pitch off looks like none.
PHASES = (0.0, 1 / 3, -1 / 3)
#: Tilts (pitch, yaw) of the views that a marker is calibrated from [deg].
VIEWS_DEG = ((-25, -25), (-25, 0), (-25, 25), (0, -25), (0, 0), (0, 25), (25, -25), (25, 0), (25, 25))
#: Views of the chessboard: tilts (pitch, yaw) [deg] and the board's place off the axis, over its range.
BOARD_VIEWS = (
    (-30, 0, 0.0, 0.0),
    (30, 0, 0.024, 0.024),
    (0, -30, -0.024, 0.024),
    (0, 30, 0.024, -0.024),
    (-25, 25, -0.016, -0.016),
    (25, 25, 0.0, 0.0),
    (25, -25, 0.016, 0.0),
    (-25, -25, 0.0, -0.016),
)
#: Roll of the board [deg]: no edge along the rows of pixels, where every sub-pixel position is the same. The focal length is
#: recovered at zero roll, too: within 0.03 %, measured.
BOARD_ROLL_DEG = 8.0
#: Pixels around the frontal marker that hold it when it is turned by up to `ROLL_DEG`, over its own.
ROLL_DEG, ROLL_MARGIN = 15.0, 0.15
#: Rays a pixel of each of the renderer's two lattices.
BOARD_RAYS = 16
#: What a camera's calibration finds, in its order.
CAMERA_PARAMETERS = (
    "focal length, columns",
    "focal length, rows",
    "principal point x",
    "principal point y",
    "k1",
    "k2",
    "p1",
    "p2",
)
#: Brightest paint over full well.
PAINT_LEVEL = 0.6


def elements_from_images(
    images: Sequence[NDArray[Any]], scenario: Scenario, poses: Sequence[KnownPose] | None = None
) -> ElementCalibration:
    """Element offsets and virtual depth of the scenario's marker from images of it by the scenario's camera.

    Raises:
        ValueError: when the images do not fit the camera, or do not tell the elements' places.
    """
    design, camera = _in_phase(images, scenario), chain.view(scenario).camera
    before: tuple[FloatArray, FloatArray] | None = None
    for _ in range(PASSES):
        found = calibrate_elements(_features(images, scenario, design), design, camera, poses)
        assumed = np.append(design.element_offsets_m, design.elements[0].virtual_depth_m)
        result = np.append(found.offsets_m, found.virtual_depth_m)
        if (np.abs(result - assumed) < SETTLED_SIGMA * found.sigma_m).all():
            break
        following = _next(assumed, result, before)
        design = replace(found, offsets_m=following[:4], virtual_depth_m=float(following[4])).marker(scenario.marker)
        before = assumed, result
    return found


def _features(images: Sequence[NDArray[Any]], scenario: Scenario, marker: MarkerDesign) -> list[Features]:
    seen = scenario.at(marker=marker.model_dump())
    return [chain.detect(seen, image).features for image in images]


def _in_phase(images: Sequence[NDArray[Any]], scenario: Scenario) -> MarkerDesign:
    """The marker with each element moved by that of `PHASES` that shows its blob in most images; by none if that is as good."""
    marker = scenario.marker
    moves = np.array(PHASES) * marker.element_length_m / marker.slit_count
    offsets = np.array(marker.element_offsets_m) + moves[:, None]
    found = []
    for moved in offsets:
        features = _features(images, scenario, marker.model_copy(update={"element_offsets_m": tuple(moved.tolist())}))
        found.append([sum(f.blobs_px[name] is not None for f in features) for name in ELEMENT_NAMES])
    best = np.argmax(found, axis=0)
    return marker.model_copy(update={"element_offsets_m": tuple(offsets[best, range(len(best))].tolist())})


def _next(assumed: FloatArray, result: FloatArray, before: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    """Where the elements should be assumed next for the result to be the same: Wegstein's secant, each value by itself.

    Where slits are resolved, a blob's light is fitted best between where it is and where the slits were thought to be, so plain
    repetition swings about the truth.
    """
    slope = np.zeros(len(result))
    if before is not None:
        run, rise = assumed - before[0], result - before[1]
        slope = np.clip(np.divide(rise, run, out=slope, where=run != 0), -STEEPEST, 0.0)
    return assumed + (result - assumed) / (1 - slope)


def camera_from_images(
    images: Sequence[NDArray[Any]], board: Chessboard, psf_sigma_px: float, distorted: bool
) -> CameraCalibration:
    """Intrinsics from images of a chessboard; images that do not show it whole are passed over.

    Raises:
        ValueError: when the images differ in size, or fewer than three show the board.
    """
    if len({image.shape for image in images}) > 1:
        raise ValueError("images: of different sizes, expected one camera's")
    corners = [chessboard_corners(image, board.inner_corners, psf_sigma_px) for image in images]
    seen = [c for c in corners if c is not None]
    if len(seen) < 3:
        columns, rows = board.inner_corners
        raise ValueError(
            f"images: {len(seen)} of {len(images)} show a chessboard of {columns} × {rows} inner corners; expected three or more"
        )
    # Centred on the board: its place before the camera is the poses' business.
    flat = board.model_copy(update={"centre_m": (0.0, 0.0)}).corners_m
    return calibrate_camera(seen, flat, images[0].shape[::-1], distorted)


def rendered_views(
    scenario: Scenario, offsets_m: Sequence[float], views_deg: Sequence[tuple[float, float]] = VIEWS_DEG
) -> tuple[list[NDArray[np.uint16]], list[KnownPose], Scenario]:
    """Frames of a marker with displaced elements, the poses they were rendered at, and the scenario of the marker as designed."""
    marker = MarkerDesign.model_validate({**scenario.marker.model_dump(), "element_offsets_m": tuple(offsets_m)})
    rng = np.random.default_rng(scenario.seed)
    # One camera for all: the frontal view is the widest.
    scale = min(chain.bit_scale_px(chain.view(scenario)))
    near = around_marker(scenario, MARGIN_PX + int(ROLL_MARGIN * scenario.marker.size_m * scale))
    images, poses = [], []
    for trial, (pitch, yaw) in enumerate(views_deg):
        target = {
            **scenario.target.model_dump(),
            "pitch_deg": pitch,
            "yaw_deg": yaw,
            "roll_deg": rng.uniform(-1, 1) * ROLL_DEG,
        }
        seen = near.at(marker=marker.model_dump(), target=target, illumination="eclipse")
        rate = chain.electron_rate(seen, chain.transport(seen), "eclipse")
        seconds = chain.solve_exposure(seen, chain.link_budget(seen, "eclipse"), seen.exposure_s)
        images.append(chain.expose(seen, rate, "eclipse", seconds, trial).dn)
        poses.append((chain.view(seen).rotation, chain.view(seen).translation_m))
    return images, poses, near


def rendered_boards(
    scenario: Scenario, board: Chessboard, views: Sequence[tuple[float, float, float, float]] = BOARD_VIEWS
) -> list[NDArray[np.uint16]]:
    """Frames of a chessboard, tilted and off the axis, in the light of the scenario's LEDs."""
    camera, images = scenario.camera, []
    quality = Quality(2, 2 * BOARD_RAYS * camera.width_px * camera.height_px, scenario.seed)
    for k, (pitch, yaw, x, y) in enumerate(views):
        target = {**scenario.target.model_dump(), "pitch_deg": pitch, "yaw_deg": yaw, "roll_deg": BOARD_ROLL_DEG}
        seen = scenario.at(target=target, illumination="eclipse")
        aside = board.model_copy(update={"centre_m": (x * scenario.range_m, y * scenario.range_m)})
        basis = next(render_bases([view_of(aside, chain.view(seen))], quality))
        rate = chain.electron_rate(seen, basis, "eclipse")
        seconds = PAINT_LEVEL * scenario.sensor.full_well_electrons / float(np.percentile(rate, 99))
        images.append(expose(scenario.sensor, rate, seconds, np.random.default_rng((scenario.seed, k))).dn)
    return images


@dataclass(frozen=True)
class Trial:
    """One thing calibrated on rendered frames."""

    what: str
    unit: str
    true: float
    found: float
    sigma: float


def element_trials(scenario: Scenario, misplaced: str = "right", by_m: float = 1e-3) -> list[Trial]:
    """The thesis's case, one element off by a millimetre, from images with unknown and with known poses."""
    offsets = [by_m if name == misplaced else 0.0 for name in ELEMENT_NAMES]
    images, poses, near = rendered_views(scenario, offsets)
    trials = []
    for label, given in (("poses unknown", None), ("poses known", poses)):
        found = elements_from_images(images, near, given)
        values = np.append(found.offsets_m, found.virtual_depth_m)
        truth = [*offsets, scenario.marker.elements[0].virtual_depth_m]
        for name, true, value, sigma in zip(
            (*ELEMENT_NAMES, "virtual depth"), truth, values, found.sigma_m, strict=True
        ):
            trials.append(Trial(f"{name}, {label}", "mm", 1e3 * true, 1e3 * float(value), 1e3 * float(sigma)))
    return trials


def camera_trials(scenario: Scenario, board: Chessboard, distorted: bool) -> list[Trial]:
    """Intrinsics recovered from rendered chessboards."""
    found = camera_from_images(rendered_boards(scenario, board), board, scenario.camera.psf_sigma_px, distorted)
    camera = scenario.camera
    truth = [*camera.focal_px, *camera.principal_point_px, camera.k1, camera.k2, camera.p1, camera.p2]
    values = [*found.focal_px, *found.principal_point_px, *found.distortion[:4]]
    units = ("px",) * 4 + ("1",) * 4
    count = 8 if distorted else 4
    return [
        Trial(name, unit, float(t), float(v), float(s))
        for name, unit, t, v, s in zip(CAMERA_PARAMETERS[:count], units, truth, values, found.sigma, strict=False)
    ]


def board_for(scenario: Scenario) -> Chessboard:
    """A chessboard that fills the scenario's frame in the views of `BOARD_VIEWS`, but for a rim."""
    field: FloatArray = np.array([scenario.camera.width_px, scenario.camera.height_px]) / scenario.camera.focal_px
    square = 0.7 * scenario.range_m * float(min(field / (12, 9)))
    return Chessboard(columns=12, rows=9, square_m=square, margin_m=square)


@dataclass(frozen=True)
class Report:
    """What `mantis calibrate` says: lines for people, plain values, and the keys of a scenario."""

    lines: tuple[str, ...]
    values: dict[str, Any]
    toml: str


def report_elements(found: ElementCalibration, scenario: Scenario) -> Report:
    """Element offsets and virtual depth with their standard deviations."""
    built, sigma = found.marker(scenario.marker), found.sigma_m
    lines = [
        f"{name:7} {1e3 * offset:+.3f} mm ± {1e3 * s:.3f} mm"
        for name, offset, s in zip(ELEMENT_NAMES, found.offsets_m, sigma, strict=False)
    ]
    lines += [
        f"virtual depth {1e3 * found.virtual_depth_m:.3f} mm ± {1e3 * sigma[4]:.3f} mm",
        f"{len(found.used)} images used, residual chi-square {found.reduced_chi2:.2f} per degree of freedom",
    ]
    marker = {
        "element_offsets_m": [round(float(o), 7) for o in found.offsets_m],
        "virtual_depth_fraction": round(built.virtual_depth_fraction, 6),
    }
    values = {
        "offsets_m": found.offsets_m,
        "virtual_depth_m": found.virtual_depth_m,
        "sigma_m": sigma,
        "used": found.used,
        "reduced_chi2": found.reduced_chi2,
    }
    return Report(tuple(lines), values, toml_text({"marker": marker}))


def report_camera(found: CameraCalibration, scenario: Scenario) -> Report:
    """Intrinsics with their standard deviations; the scenario's column pitch turns pixels into metres."""
    names = ("focal x", "focal y", "principal x", "principal y", "k1", "k2", "p1", "p2")
    values = [*found.focal_px, *found.principal_point_px, *found.distortion[:4]]
    lines = [f"{name:12} {value:.6g} ± {s:.2g}" for name, value, s in zip(names, values, found.sigma, strict=False)]
    focal_m = float(found.focal_px[0]) * scenario.camera.pixel_pitch_x_m
    off = found.principal_point_px - (np.array([scenario.camera.width_px, scenario.camera.height_px]) - 1) / 2
    lines += [
        f"{found.views} images used, corners {found.rms_px:.3f} px off, root mean square",
        f"principal point ({off[0]:+.2f}, {off[1]:+.2f}) px off the frame's middle, where a scenario has it",
    ]
    camera = {
        "focal_length_m": round(focal_m, 8),
        "pixel_pitch_y_m": float(f"{focal_m / found.focal_px[1]:.7g}"),
        **{key: round(float(v), 6) for key, v in zip(("k1", "k2", "p1", "p2"), found.distortion, strict=False)},
    }
    record = {
        "focal_px": found.focal_px,
        "principal_point_px": found.principal_point_px,
        "distortion": found.distortion,
        "sigma": found.sigma,
        "rms_px": found.rms_px,
        "views": found.views,
    }
    return Report(tuple(lines), record, toml_text({"camera": camera}))


def board_of(squares: str, square_m: float) -> Chessboard:
    """A chessboard from its squares, '12x9', and their side.

    Raises:
        ValueError: when the squares are not two whole numbers.
    """
    columns, _, rows = squares.lower().partition("x")
    if not (columns.isdigit() and rows.isdigit()):
        raise ValueError(f"--squares {squares}: expected two whole numbers, say 12x9")
    return Chessboard(columns=int(columns), rows=int(rows), square_m=square_m, margin_m=square_m)
