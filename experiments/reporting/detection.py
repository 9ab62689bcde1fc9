"""What `mantis detect` says of an image: one JSON object, or a few lines for people."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.chain import Detection


def as_record(seen: Detection) -> dict[str, Any]:
    """Plain data: detected, id, corners_px, blobs_px, virtual_points_px, pose or null, blur_px, blur_deviation_px, reason."""
    features, pose = seen.features, seen.pose
    reason = features.reason
    if features.detected and pose is None:
        reason = "; ".join(filter(None, [reason, "no pose before the camera fits the corners"]))
    return {
        "detected": features.detected,
        "id": features.identity,
        "corners_px": None if features.corners_px is None else features.corners_px.tolist(),
        "blobs_px": {name: None if blob is None else blob.tolist() for name, blob in features.blobs_px.items()},
        "virtual_points_px": {name: point.tolist() for name, point in features.virtual_points_px.items()},
        "pose": None
        if pose is None
        else {
            "R": pose.rotation.tolist(),
            "t_m": pose.translation_m.tolist(),
            "covariance": pose.covariance.tolist(),
            "ambiguous": pose.ambiguous,
        },
        "blur_px": features.blur_px,
        "blur_deviation_px": features.blur_deviation_px,
        "reason": reason,
    }


def describe(seen: Detection) -> list[str]:
    """Lines for a terminal."""
    features, pose = seen.features, seen.pose
    if not features.detected:
        return [f"Not detected: {features.reason}"]
    assert features.corners_px is not None
    blobs = [name for name, blob in features.blobs_px.items() if blob is not None]
    lines = [
        f"Marker {features.identity}, corners "
        + " ".join(f"({x:.2f}, {y:.2f})" for x, y in features.corners_px)
        + " px",
        f"Blobs: {', '.join(blobs) or 'none'}" + (f" ({features.reason})" if features.reason else ""),
    ]
    if pose is None:
        return [*lines, "No pose before the camera fits the corners"]
    x, y, z = pose.translation_m
    sigma = np.sqrt(np.diag(pose.covariance))
    tilt = np.degrees(np.arccos(np.clip(-pose.rotation[2, 2], -1, 1)))
    return [
        *lines,
        f"Position ({x:.4f}, {y:.4f}, {z:.4f}) m ± ({sigma[3]:.1g}, {sigma[4]:.1g}, {sigma[5]:.1g}) m",
        f"Tilt {tilt:.2f} deg, attitude ± {np.degrees(np.linalg.norm(sigma[:3])):.2g} deg"
        + (", AMBIGUOUS" if pose.ambiguous else ""),
    ]
