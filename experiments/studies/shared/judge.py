"""What a method made of a frame, held against the truth: errors, and the failures of thesis section 8.3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detector.elements.blobs import MAX_CUT_FRACTION
from detector.elements.slits import Slits
from experiments.studies.shared.trackers import Design, TrackerResult
from radiometry.geometry import FRONTAL, FloatArray, rotation_angle
from scenes.marker import MarkerDesign
from scenes.tags import DotPlate, TagPlate
from scenes.view import View

#: A corner further off than this, over the ArUco's side, is wrong: half the diagonal of the narrow ring, so nearer to that ring's
#: outer corner than to its own.
WRONG_CORNER = 0.5 * np.sqrt(2) * 0.06
#: Corners further off than this, rms and in bits, are another thing.
MISPLACED_BITS = 1.0
#: What is kept of every frame: unit and long name. Errors are measured minus true, NaN without a pose.
VARIABLES: dict[str, tuple[str, str]] = {
    "found": ("1", "target found at its place"),
    "pitch_error_deg": ("degree", "error of the pitch"),
    "yaw_error_deg": ("degree", "error of the yaw"),
    "attitude_error_deg": ("degree", "angle between true and measured attitude"),
    "range_error_m": ("m", "error of the range"),
    "pitch_sigma_deg": ("degree", "standard deviation of the pitch that the solver states"),
    "point_error_px": ("pixel", "largest error of a corner"),
    "blobs_found": ("1", "blobs found, of those that stand in their openings"),
    "blobs_there": ("1", "blobs that stand in their openings"),
    "loss_of_aruco": ("1", "no square found, or none whose bits decode (failure mode 1 of thesis section 8.3)"),
    "false_positive": ("1", "another identity, or a marker elsewhere (failure mode 2)"),
    "loss_of_elements": ("1", "square found, but no two blobs that make a virtual point (failure mode 3)"),
    "wrong_corners": ("1", "square found with a corner nearer to the ring's outer corner than to its own (failure mode 4)"),
    "no_blob": ("1", "square found, but not every blob that stands in its opening (failure mode 5)"),
}  # fmt: skip
FAILURES = ("loss_of_aruco", "false_positive", "loss_of_elements", "wrong_corners", "no_blob")


@dataclass(frozen=True)
class Truth:
    """A frame's target, attitude and camera."""

    design: Design
    view: View

    @property
    def points_px(self) -> FloatArray:
        """Feature points (n, 2), corners first [px]."""
        points = self.design.points_m if isinstance(self.design, DotPlate) else self.design.corners_m
        return self.view.to_image(points)

    def blobs(self) -> frozenset[str]:
        """Elements in whose opening the blob stands, but for as much as a detector may lose."""
        if not isinstance(self.design, MarkerDesign):
            return frozenset()
        camera_m = self.view.to_marker(np.zeros(3))
        return frozenset(
            e.name
            for e in self.design.elements
            if Slits(self.design, e, camera_m).cut_fraction(float(e.blob_offset_m(camera_m))) <= MAX_CUT_FRACTION
        )

    def judge(self, result: TrackerResult) -> dict[str, float]:
        """Values of `VARIABLES`; those that a target does not have are left out."""
        side_m = self.design.aruco_m
        side_px = side_m * float(np.mean(self.view.camera.focal_px)) / self.view.range_m
        error = np.inf
        elsewhere = False
        if result.points_px is not None:
            distance = np.linalg.norm(result.points_px - self.points_px, axis=1)
            error = float(distance.max())
            bit_px = side_px * self.design.bit_m / side_m
            elsewhere = float(np.sqrt(np.mean(distance**2))) > MISPLACED_BITS * bit_px
        found = np.isfinite(error) and not elsewhere
        values = {
            "found": float(found),
            "loss_of_aruco": float(not found),
            "false_positive": float(result.other or elsewhere),
        }
        if found:
            values |= {"point_error_px": error, **self._pose_errors(result)}
        if isinstance(self.design, (MarkerDesign, TagPlate)):
            values["wrong_corners"] = float(found and error > WRONG_CORNER * side_px)
        if result.blobs is not None:
            there = self.blobs()
            values |= {
                "blobs_there": len(there), "blobs_found": len(there & result.blobs),
                "loss_of_elements": float(found and not result.virtual), "no_blob": float(found and not there <= result.blobs),
            }  # fmt: skip
        return values

    def _pose_errors(self, result: TrackerResult) -> dict[str, float]:
        if result.rotation is None or result.translation_m is None:
            return {}
        off = tilt_deg(result.rotation) - tilt_deg(self.view.rotation)
        pitch, yaw = (off + 180) % 360 - 180
        distance = float(np.linalg.norm(result.translation_m) - np.linalg.norm(self.view.translation_m))
        return {
            "pitch_error_deg": float(pitch), "yaw_error_deg": float(yaw), "range_error_m": distance,
            "attitude_error_deg": float(np.degrees(rotation_angle(self.view.rotation, result.rotation))),
            "pitch_sigma_deg": float(np.degrees(result.sigma_pitch_rad)),
        }  # fmt: skip


def tilt_deg(rotation: FloatArray) -> FloatArray:
    """Pitch and yaw (2,) [deg] of an attitude (3, 3): angles of R_0 · Rz · Ry(yaw) · Rx(pitch)."""
    turned = FRONTAL.T @ rotation
    pitch = np.arctan2(turned[2, 1], turned[2, 2])
    return np.degrees([pitch, -np.arcsin(np.clip(turned[2, 0], -1.0, 1.0))])
