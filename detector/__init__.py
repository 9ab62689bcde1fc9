"""Sensor, feature extraction and pose."""

__all__ = [
    "calibration",
    "compiled",
    "detect",
    "elements",
    "features",
    "pattern",
    "pnp",
    "pose",
    "rectify",
    "sensor",
    "version",
]
