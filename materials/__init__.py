"""Reflectance of tape, absorber, paint and foil: one definition each, for the budget and for the renderer."""

__all__ = [
    "brdf",
    "datafile",
    "goniometer",
    "library",
    "plugins",
]
