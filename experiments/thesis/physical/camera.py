"""The laboratory's camera as it is known: calibrated from rendered chessboards, cropped, and scaled as in section 7.1.5."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.calibration.camera import CameraCalibration
from detector.sensor.noise import NoiseModel
from experiments.scenario import Scenario
from experiments.studies.shared.baseline import to_eight_bits
from experiments.studies.shared.calibrations import camera_from_images, rendered_boards
from experiments.thesis.physical.arm import table
from experiments.thesis.physical.plan import Plan
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.chessboard import Chessboard

#: Part of the whole detector's columns with which listing A.3 first looks for the corners, half the side of its window [px], and
#: where its refinement ends.
FIRST_LOOK, WINDOW_PX, ENDS = 0.2, 11, (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
#: Boards are lit evenly, as a room lights them: LEDs with this half angle [deg]; their intensity is exposed for.
ROOM_HALF_ANGLE_DEG, ROOM_W_SR = 70.0, 0.05


class SolvedCamera(Camera):
    """A camera whose focal lengths and principal point are known in pixels, rather than by pitch and middle of the detector."""

    solved_focal_px: tuple[float, float]
    solved_principal_px: tuple[float, float]

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal length in columns and in rows [px]."""
        return self.solved_focal_px

    @property
    def principal_point_px(self) -> tuple[float, float]:
        """Where the axis meets the detector [px]."""
        return self.solved_principal_px


def solved(camera: Camera, found: CameraCalibration) -> SolvedCamera:
    """The whole camera as a calibration of it has it."""
    keys = dict(zip(("k1", "k2", "p1", "p2", "k3"), map(float, found.distortion), strict=True))
    focal, principal = (tuple(float(v) for v in pair) for pair in (found.focal_px, found.principal_point_px))
    return SolvedCamera(**{**camera.model_dump(), **keys}, solved_focal_px=focal[:2], solved_principal_px=principal[:2])


def cropped(camera: SolvedCamera, crop: Camera) -> SolvedCamera:
    """A solved camera's middle, of the size of a crop."""
    off = (camera.width_px - crop.width_px) / 2, (camera.height_px - crop.height_px) / 2
    at = tuple(p - o for p, o in zip(camera.solved_principal_px, off, strict=True))
    size = {"width_px": crop.width_px, "height_px": crop.height_px, "solved_principal_px": at}
    return camera.model_copy(update={**size, "psf_sigma_px": crop.psf_sigma_px, "focus_m": None})


def camera_of(rectified: SolvedCamera, real: Camera) -> SolvedCamera:
    """The true intrinsics in the pixels of a rectified image, whose first pixel is the frame's own."""
    true = {"solved_focal_px": real.focal_px, "solved_principal_px": real.principal_point_px}
    return rectified.model_copy(update=true)


@dataclass(frozen=True)
class Scaling:
    """Section 7.1.5: an image made smaller, and padded with its outer pixels to a frame of other size."""

    factor: float
    width_px: int
    height_px: int

    def image(self, image: FloatArray) -> FloatArray:
        """The frame (height_px, width_px): every pixel the mean of what it covers, then the rim repeated."""
        height, width = (round(n * self.factor) for n in image.shape)
        small = cv2.resize(np.asarray(image, np.float32), (width, height), interpolation=cv2.INTER_AREA)
        top, left = self._rim(width, height)
        right, bottom = self.width_px - width - left, self.height_px - height - top
        return cv2.copyMakeBorder(small, top, bottom, left, right, cv2.BORDER_REPLICATE).astype(float)

    def _rim(self, width: int, height: int) -> tuple[int, int]:
        """Pixels above and to the left of the small image."""
        top, left = (self.height_px - height) // 2, (self.width_px - width) // 2
        if min(top, left) < 0:
            raise ValueError(
                f"scaling: image of {width} × {height} px, expected to fit {self.width_px} × {self.height_px}"
            )
        return top, left

    def camera(self, camera: Camera) -> SolvedCamera:
        """Intrinsics of the scaled frame; pixel centres lie at whole numbers before and after."""
        sides = (camera.width_px, camera.height_px)
        small = tuple(round(n * self.factor) for n in sides)
        ratio = [s / n for s, n in zip(small, sides, strict=True)]
        top, left = self._rim(*small)
        focal = tuple(f * r for f, r in zip(camera.focal_px, ratio, strict=True))
        principal = tuple(
            (p + 0.5) * r - 0.5 + o for p, r, o in zip(camera.principal_point_px, ratio, (left, top), strict=True)
        )
        own = {name: getattr(camera, name) for name in Camera.model_fields}
        own |= {
            "width_px": self.width_px,
            "height_px": self.height_px,
            "psf_sigma_px": camera.psf_sigma_px * self.factor,
        }
        return SolvedCamera(**own, solved_focal_px=focal[:2], solved_principal_px=principal[:2])

    def noise(self, noise: NoiseModel) -> NoiseModel:
        """Noise of the scaled image's pixels, means of 1/factor² of the image's."""
        return NoiseModel(
            noise.gain_dn_per_electron * self.factor**2,
            noise.read_noise_dn * self.factor,
            noise.offset_dn,
            noise.saturation_dn,
        )


def scaling(scenario: Scenario) -> Scaling:
    """As large as the Blender model's marker at the table's range when the first pass is nearest."""
    told = table()["scaling"]
    focal = told["width_px"] / 2 / np.tan(np.radians(told["field_deg"]) / 2)
    wanted = told["marker_m"] * focal / told["range_m"]
    own = scenario.marker.size_m * max(scenario.camera.focal_px) / table()["arm"]["distance_m"]
    return Scaling(float(wanted / own), told["width_px"], told["height_px"])


@dataclass(frozen=True)
class Calibrated:
    """The camera from chessboards, in pixels of the whole detector.

    Attributes:
        found: this project's corners.
        listing: by listing A.3's own steps.
        listing_error_px: what the listing calls its mean reprojection error: the root of the mean of the views' whole distances.
        listing_rms_px: root mean square distance of the listing's corners from where its solution puts them.
        images: boards as digital numbers, of the binned detector.
    """

    found: CameraCalibration
    listing: CameraCalibration
    listing_error_px: float
    listing_rms_px: float
    images: list[NDArray[np.uint16]]


def calibrate(scenario: Scenario, plan: Plan) -> Calibrated:
    """Render chessboards through the scenario's whole camera, binned, and solve it by both ways.

    Raises:
        ValueError: when too few boards are seen whole.
    """
    told = table()["board"]
    binning = plan.binning or told["binning"]
    binned = _binned(scenario, binning)
    keys = ("columns", "rows", "square_m", "margin_m")
    board = Chessboard(**{key: told[key] for key in keys})
    images = rendered_boards(binned, board, [tuple(view) for view in told["views"][: plan.boards]])
    found = camera_from_images(images, board, binned.camera.psf_sigma_px, distorted=True)
    by_listing, error, rms = listing(images, board, binned, binning)
    return Calibrated(whole(found, binning), whole(by_listing, binning), error * binning**0.5, rms * binning, images)


def _binned(scenario: Scenario, binning: int) -> Scenario:
    """The scenario at the board's distance, its detector read out in squares of so many pixels."""
    camera = scenario.camera
    changes: dict[str, Any] = {
        "width_px": camera.width_px // binning,
        "height_px": camera.height_px // binning,
        "pixel_pitch_x_m": camera.pixel_pitch_x_m * binning,
        "pixel_pitch_y_m": camera.pixel_pitch_y_m * binning,
        "psf_sigma_px": camera.psf_sigma_px / binning,
    }
    room = {**scenario.leds.model_dump(), "half_angle_deg": ROOM_HALF_ANGLE_DEG, "intensity_w_sr": ROOM_W_SR}
    return scenario.at(camera={**camera.model_dump(), **changes}, leds=room, range_m=table()["board"]["range_m"])


def whole(found: CameraCalibration, binning: int) -> CameraCalibration:
    """A calibration of the binned detector in pixels of the whole one."""
    sigma = found.sigma.copy()
    sigma[:4] *= binning
    return CameraCalibration(
        focal_px=found.focal_px * binning,
        principal_point_px=(found.principal_point_px + 0.5) * binning - 0.5,
        distortion=found.distortion,
        sigma=sigma,
        rms_px=found.rms_px * binning,
        views=found.views,
    )


def listing(
    images: Sequence[NDArray[np.uint16]], board: Chessboard, scenario: Scenario, binning: int
) -> tuple[CameraCalibration, float, float]:
    """Listing A.3's steps: corners in a smaller image, refined in a window, then five coefficients of distortion.

    The small image is as small as the listing's where binning allows; the window has its pixels, but binned ones.

    Returns:
        Calibration, the listing's error √(Σ n‖·‖ / Σ n), and the root mean square distance, both in the images' pixels.

    Raises:
        ValueError: when fewer than three boards are found.
    """
    sensor, corners = scenario.sensor, []
    first_look, window = min(1.0, FIRST_LOOK * binning), (round(WINDOW_PX * table()["board"]["binning"] / binning),) * 2
    for image in images:
        grey = to_eight_bits(image, sensor.offset_dn, max(float(image.max()), sensor.offset_dn + 1))
        small = cv2.resize(grey, None, fx=first_look, fy=first_look)
        success, rough = cv2.findChessboardCorners(small, board.inner_corners, flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
        if success:
            first = np.ascontiguousarray(rough / first_look, np.float32)
            corners.append(cv2.cornerSubPix(grey, first, window, (-1, -1), ENDS).reshape(-1, 1, 2))
    if len(corners) < 3:
        raise ValueError(f"listing A.3: {len(corners)} boards found, expected three or more")
    # The listing counts from a corner of the board, and downwards; where its origin lies is the poses' business.
    columns, rows = board.inner_corners
    at = np.array([(x, y, 0.0) for y in range(rows) for x in range(columns)], np.float32) * board.square_m
    size = images[0].shape[::-1]
    rms, matrix, lens, turns, moves, sigma, *_ = cv2.calibrateCameraExtended(
        [at] * len(corners), corners, size, np.eye(3), np.zeros(5)
    )
    norms = [
        float(np.linalg.norm(c - cv2.projectPoints(at, r, t, matrix, lens)[0]))
        for c, r, t in zip(corners, turns, moves, strict=True)
    ]
    found = CameraCalibration(
        focal_px=np.array([matrix[0, 0], matrix[1, 1]]),
        principal_point_px=matrix[:2, 2].copy(),
        distortion=np.ravel(lens)[:5],
        sigma=np.ravel(sigma)[:9],
        rms_px=float(rms),
        views=len(corners),
    )
    return found, float(np.sqrt(np.mean(norms))), float(rms)
