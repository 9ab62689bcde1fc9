"""Closed-form physics: spectra, sources, optics, link budget, closure, and the thesis as printed and corrected."""

__all__ = [
    "closure",
    "corrections",
    "distortion",
    "earth",
    "encoding",
    "extensions",
    "field_of_view",
    "filters",
    "geometry",
    "laboratory",
    "link",
    "optics",
    "parameters",
    "power",
    "sources",
    "spectrum",
    "stray",
    "thesis",
]
