"""Pose from points by published solvers, each by itself: a subject of study, not used by the detector."""

__all__ = [
    "dls",
    "epnp",
    "pnp",
    "posit",
]
