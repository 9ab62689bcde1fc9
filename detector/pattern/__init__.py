"""The ArUco pattern: candidates, their bits, and the corners of the best."""

__all__ = [
    "candidates",
    "corner_fit",
    "corners",
    "decode",
    "find",
    "pattern",
]
