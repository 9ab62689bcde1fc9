"""Analytic hierarchy process: the thesis's trade-off, and any other."""
