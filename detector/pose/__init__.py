"""Pose, its covariance and its bounds, from corners and blobs."""
