"""What the borders add to the corners: the ring's outer edge, and the outline of the whole marker."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from synthetic import NOISE, electrons, expose, pose_at

from detector.features import find_features
from detector.pattern.corners import fit_pattern
from detector.pattern.pattern import CLEARANCE, SQUARE, Pattern, homography, kernel_sigma_px, project
from detector.pose.bounds import bound
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

MARKER, CAMERA = MarkerDesign(), Camera(width_px=160, height_px=160)
SIGMA_PX = kernel_sigma_px(CAMERA.psf_sigma_px)
WHITE, BLACK = 6500.0, 130.0


def pose_and_corners(range_m: float) -> tuple[tuple, FloatArray]:
    pose = pose_at(range_m, 10, -7, 20, (0.3, 0.2), CAMERA)
    return pose, CAMERA.project(MARKER.corners_m @ pose[0].T + pose[1])


def printed(corners: FloatArray, pixels: FloatArray, lines: FloatArray, cells: FloatArray) -> FloatArray:
    """Blurred light (n,) of cells between grid lines at pixels (n, 2), by the error function in the marker's plane."""
    back = np.linalg.inv(homography(corners))
    place, step = project(back, pixels), 1e-3
    by = [
        (project(back, pixels + step * e) - project(back, pixels - step * e)) / (2 * step) for e in np.eye(2)
    ]  # of the place, by column and by row
    blur = np.hypot(*by) * SIGMA_PX
    across = [np.diff(ndtr((lines[:, None] - place[:, k]) / blur[:, k]), axis=0) for k in range(2)]
    return np.einsum("in,ij,jn->n", across[0], cells, across[1])


def corner_sigma(range_m: float, lines: FloatArray, cells: FloatArray, reach: float, clear_px: float) -> float:
    """Cramér–Rao bound of a corner's coordinate [px] from the pixels within a square of the plane, less a margin."""
    _, corners = pose_and_corners(range_m)
    column, row = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    pixels = np.stack([column, row], -1).reshape(-1, 2).astype(float)
    half_px = np.linalg.norm(corners[1] - corners[0]) / 2
    inside = np.abs(project(np.linalg.inv(homography(corners)), pixels)).max(1) < reach - clear_px / half_px
    pixels, step = pixels[inside], 1e-3
    derivatives = []
    for k in range(8):
        change = step * np.eye(8)[k].reshape(4, 2)
        more, less = (printed(corners + s * change, pixels, lines, cells) for s in (1, -1))
        derivatives.append(WHITE * (more - less) / (2 * step))
    light = printed(corners, pixels, lines, cells)
    variance = BLACK + WHITE * light + 28.2**2
    covariance = bound(np.array(derivatives), variance, np.array([light, np.ones_like(light)]))
    return float(np.sqrt(np.trace(covariance) / 8))


@pytest.mark.parametrize("range_m", [3.0, 7.0, 11.0])
def test_without_the_ring_s_outer_edge_corners_would_be_known_half_as_well(range_m: float) -> None:
    """Recommendation 2 of the thesis: the outer border as a source of corners."""
    pattern = Pattern(MARKER)
    endless = np.concatenate([[-9.0], pattern.lines[1:-1], [9.0]])
    without = corner_sigma(range_m, endless, pattern.cells, pattern.ring, CLEARANCE * SIGMA_PX)
    whole = corner_sigma(range_m, pattern.lines, pattern.cells, pattern.outline, CLEARANCE * SIGMA_PX)
    assert without > 1.5 * whole


@pytest.mark.parametrize("range_m", [3.0, 7.0])
def test_the_fit_uses_the_ring_s_outer_edge(range_m: float) -> None:
    """Scatter of the corners over noise, beside that of a fit which stops short of the edge."""
    pose, truth = pose_and_corners(range_m)
    rng = np.random.default_rng(1)
    mean = electrons(MARKER, CAMERA, *pose, rng, white=1500.0, foil_level=0.0, samples=12)
    cut = Pattern(MARKER)
    cut.lines[0], cut.lines[-1], cut.outline = -9.0, 9.0, cut.ring
    images = [expose(mean, rng) for _ in range(60)]
    ours = np.array([find_features(image, MARKER, CAMERA, NOISE, 0.0).corners_px for image in images])
    short = [fit_pattern(image, cut, truth, SIGMA_PX, NOISE) for image in images]
    assert all(fit is not None for fit in short)
    scatter = [np.sqrt(np.var(c, axis=0, ddof=1).mean()) for c in (ours, np.array([f.corners_px for f in short if f]))]
    # 59 degrees of freedom of some eight correlated coordinates: the ratio is known to 7 %.
    assert scatter[1] > 1.3 * scatter[0]


def test_the_marker_s_outline_before_dim_surroundings_adds_next_to_nothing() -> None:
    """Why the fit stops there: even if its light were even and known, a background at 10 % of the tape would add 6 %."""
    pattern = Pattern(MARKER)
    lines = np.concatenate([[-9.0, -pattern.outline], pattern.lines, [pattern.outline, 9.0]])
    own = corner_sigma(6.0, pattern.lines, pattern.cells, pattern.outline, CLEARANCE * SIGMA_PX)
    gains = {}
    for background in (0.1, 1.0):
        cells = np.pad(np.pad(pattern.cells, 1), 1, constant_values=background)
        gains[background] = own / corner_sigma(6.0, lines, cells, pattern.outline + 1.0, 0.0)
    assert 1.0 < gains[0.1] < 1.06
    assert gains[1.0] > 1.5
    # The corners of the outline themselves are where the homography puts them: no further unknowns.
    _, corners = pose_and_corners(6.0)
    outline = project(homography(corners), SQUARE * pattern.outline)
    half = MARKER.size_m / 2
    pose = pose_at(6.0, 10, -7, 20, (0.3, 0.2), CAMERA)
    places = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    np.testing.assert_allclose(outline, CAMERA.project(places @ pose[0].T + pose[1]), atol=1e-9)
