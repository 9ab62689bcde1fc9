"""Calibration from images: where a marker's elements stand, and a camera by a board."""

__all__ = [
    "camera",
    "elements",
]
