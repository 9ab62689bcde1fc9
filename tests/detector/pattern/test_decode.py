"""Decoding of a quadrilateral."""

from __future__ import annotations

import numpy as np
from synthetic import NOISE

from detector.pattern.decode import decoder_of
from scenes.marker import MarkerDesign

MARKER = MarkerDesign()


def test_a_quadrilateral_without_a_reading_of_a_cell_is_no_marker():
    """Concave, and partly outside the image: all its readings lie on the border, and nothing can be solved for the cells."""
    image = np.random.default_rng(0).normal(500, 10, (300, 300))
    quadrilateral = np.array([[170.428, 180.268], [131.361, 199.478], [148.093, 115.910], [307.427, 81.745]])
    assert decoder_of(MARKER).decode(image, quadrilateral, 0.6, NOISE) is None
