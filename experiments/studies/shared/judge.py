"""What a method made of a frame, compared with the truth: errors, and the failures of thesis section 8.3."""

from __future__ import annotations

import numpy as np

from experiments.studies.shared.trackers import TrackerResult
from experiments.studies.shared.truth import MISPLACED_BITS, Truth
from radiometry.geometry import FRONTAL, FloatArray, rotation_angle
from scenes.marker import MarkerDesign
from scenes.tags import TagPlate

#: A corner further off than this, over the ArUco's side, is wrong: half the diagonal of the narrow ring, so nearer to that ring's
#: outer corner than to its own.
WRONG_CORNER = 0.5 * np.sqrt(2) * 0.06
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
    "wrong_corners": (
        "1",
        "square found with a corner nearer to the ring's outer corner than to its own (failure mode 4)",
    ),
    "no_blob": ("1", "square found, but not every blob that stands in its opening (failure mode 5)"),
}
FAILURES = ("loss_of_aruco", "false_positive", "loss_of_elements", "wrong_corners", "no_blob")


def judge(truth: Truth, detection: TrackerResult) -> dict[str, float]:
    """Values of `VARIABLES`; those that a target does not have are left out."""
    error, elsewhere = np.inf, False
    if detection.points_px is not None:
        distance = np.linalg.norm(detection.points_px - truth.points_px, axis=1)
        error = float(distance.max())
        bit_px = truth.side_px * truth.design.bit_m / truth.design.aruco_m
        elsewhere = float(np.sqrt(np.mean(distance**2))) > MISPLACED_BITS * bit_px
    found = np.isfinite(error) and not elsewhere
    values = {
        "found": float(found),
        "loss_of_aruco": float(not found),
        "false_positive": float(detection.other or elsewhere),
    }
    if found:
        values |= {"point_error_px": error, **_pose_errors(truth, detection)}
    if isinstance(truth.design, (MarkerDesign, TagPlate)):
        values["wrong_corners"] = float(found and error > WRONG_CORNER * truth.side_px)
    if detection.blobs is not None:
        there = truth.blobs_in_openings
        values |= {
            "blobs_there": len(there),
            "blobs_found": len(there & detection.blobs),
            "loss_of_elements": float(found and not detection.virtual),
            "no_blob": float(found and not there <= detection.blobs),
        }
    return values


def _pose_errors(truth: Truth, detection: TrackerResult) -> dict[str, float]:
    if detection.rotation is None or detection.translation_m is None:
        return {}
    off = tilt_deg(detection.rotation) - tilt_deg(truth.view.rotation)
    pitch, yaw = (off + 180) % 360 - 180
    distance = float(np.linalg.norm(detection.translation_m) - np.linalg.norm(truth.view.translation_m))
    return {
        "pitch_error_deg": float(pitch),
        "yaw_error_deg": float(yaw),
        "range_error_m": distance,
        "attitude_error_deg": float(np.degrees(rotation_angle(truth.view.rotation, detection.rotation))),
        "pitch_sigma_deg": float(np.degrees(detection.sigma_pitch_rad)),
    }


def tilt_deg(rotation: FloatArray) -> FloatArray:
    """Pitch and yaw (2,) [deg] of an attitude (3, 3): angles of R_0 · Rz · Ry(yaw) · Rx(pitch)."""
    turned = FRONTAL.T @ rotation
    pitch = np.arctan2(turned[2, 1], turned[2, 2])
    return np.degrees([pitch, -np.arcsin(np.clip(turned[2, 0], -1.0, 1.0))])
