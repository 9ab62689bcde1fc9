"""Pose from random points: the thesis's Monte Carlo, as listed and as meant."""
