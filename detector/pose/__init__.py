"""Pose, its covariance and its bounds, from corners and blobs."""

__all__ = [
    "bounds",
    "joint",
    "pose",
    "pose_fit",
]
