"""Brown–Conrady lens distortion, its inverse, and the range of field angles over which the two match.

Coordinates are tangents of the field angle, x to the right and y down. (x, y) are the ideal ones of a pinhole, (x_d, y_d)
the distorted ones, where the lens images the point. With r² = x² + y², coefficients and signs are OpenCV's (calib3d,
"Detailed Description"; after D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37, 1971):

    x_d = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y_d = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y

The formulas are plain arithmetic, so that the same code serves numpy arrays and the renderer's numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from radiometry.geometry import FloatArray

#: Newton steps of the inverse. Each squares the error. `max_ideal_radius` refuses coefficients that leave more than `RESIDUAL`.
STEPS = 8
#: Largest error of the inverse within the frame, in double precision [tangent]; single precision leaves some 1e-7.
RESIDUAL = 1e-10


@dataclass(frozen=True)
class BrownConrady:
    """Coefficients of a lens's distortion, and the mapping that they define.

    Attributes:
        k1, k2, k3: radial coefficients [-].
        p1, p2: tangential coefficients [-].

    All are numbers, or the renderer's own scalars.
    """

    k1: Any = 0.0
    k2: Any = 0.0
    p1: Any = 0.0
    p2: Any = 0.0
    k3: Any = 0.0

    def distort(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Distorted coordinates of ideal ones.

        Args:
            x: ideal coordinates to the right [tangent].
            y: ideal coordinates downwards [tangent], of the same shape.

        Returns:
            (x_d, y_d), of the shape of the input.
        """
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        cross = 2.0 * x * y
        return (
            x * radial + self.p1 * cross + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + self.p2 * cross,
        )

    def derivative(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Derivative of the distorted coordinates by the ideal ones. It is a symmetric matrix, so three numbers hold it.

        Args:
            x: ideal coordinates to the right [tangent].
            y: ideal coordinates downwards [tangent], of the same shape.

        Returns:
            ∂x_d/∂x, ∂x_d/∂y = ∂y_d/∂x, and ∂y_d/∂y.
        """
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3))
        return (
            radial + x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
            radial + y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )

    def undistort(self, x_distorted: Any, y_distorted: Any) -> tuple[Any, Any]:
        """Ideal coordinates of distorted ones, by Newton's method from the distorted ones.

        Args:
            x_distorted: to the right [tangent].
            y_distorted: downwards [tangent], of the same shape.

        Returns:
            (x, y), of the shape of the input. The error within the frame is at most `RESIDUAL` in double precision.
        """
        x, y = x_distorted, y_distorted
        for _ in range(STEPS):
            x_there, y_there = self.distort(x, y)
            xx, xy, yy = self.derivative(x, y)
            determinant = xx * yy - xy * xy
            x_off, y_off = x_distorted - x_there, y_distorted - y_there
            x, y = x + (yy * x_off - xy * y_off) / determinant, y + (xx * y_off - xy * x_off) / determinant
        return x, y


@lru_cache(maxsize=64)
def max_ideal_radius(lens: BrownConrady, half_width: float, half_height: float) -> float:
    """Largest ideal radius that a frame shows [tangent].

    Within this radius the derivative is checked to be positive definite, which makes the lens one-to-one on the disc.

    Args:
        lens: the distortion.
        half_width: half the frame's width in distorted coordinates [tangent].
        half_height: half the frame's height in distorted coordinates [tangent].

    Raises:
        ValueError: when the lens folds the image back within the frame, so that some pixels have no ideal position.
    """
    edge = np.linspace(-1.0, 1.0, 33)
    border = np.concatenate([np.stack([edge, 0 * edge + s], axis=-1) for s in (-1.0, 1.0)])
    border = np.concatenate([border, border[:, ::-1]]) * (half_width, half_height)
    with np.errstate(all="ignore"):  # what diverges is refused below
        x, y = lens.undistort(*border.T)
        error = np.hypot(*(np.array(lens.distort(x, y)) - border.T))
        radius = float(np.hypot(x, y).max())
        rim, turn = np.linspace(0.0, radius, 33), np.linspace(0.0, 2 * np.pi, 49)[:, None]
        xx, xy, yy = lens.derivative(rim * np.cos(turn), rim * np.sin(turn))
        sound = (error.max() <= RESIDUAL) & np.all(xx > 0) & np.all(xx * yy > xy**2)
    if not sound:
        coefficients = ", ".join(f"{name} = {value:g}" for name, value in vars(lens).items() if value)
        raise ValueError(
            f"{coefficients}: this distortion folds the image back within the frame; expected coefficients that are one-to-one "
            f"out to its corners, {np.degrees(np.arctan(np.hypot(half_width, half_height))):.1f} deg off the axis"
        )
    return radius


def distort_everywhere(
    lens: BrownConrady, x: FloatArray, y: FloatArray, reach_tangent: float
) -> tuple[FloatArray, FloatArray]:
    """Distorted coordinates that also make sense far outside the frame.

    Beyond a radius, where the polynomial would fold back into the frame, the distortion goes on in a straight line
    outwards.

    Args:
        lens: the distortion.
        x: ideal coordinates to the right [tangent].
        y: ideal coordinates downwards [tangent], of the same shape.
        reach_tangent: the radius, from `max_ideal_radius` [tangent].

    Returns:
        (x_d, y_d), of the shape of the input.
    """
    radius = np.hypot(x, y)
    inner = np.minimum(1.0, reach_tangent / np.maximum(radius, 1e-300))
    x_distorted, y_distorted = lens.distort(x * inner, y * inner)
    return x_distorted + x * (1.0 - inner), y_distorted + y * (1.0 - inner)
