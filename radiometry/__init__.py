"""Closed-form physics: spectra, sources, optics, link budget, closure, and the thesis as printed and corrected."""
