"""Camera optics: projection, point spread, and radiance to electron rate."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field
from scipy import constants
from scipy.special import erf, ndtr

from radiometry.geometry import FloatArray
from radiometry.spectrum import Spectrum

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class Camera(BaseModel):
    """A monochrome camera's lens and pixel grid. Pixel centres lie at integer coordinates."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    width_px: int = Field(752, ge=16, le=16384, description="columns of the detector")
    height_px: int = Field(580, ge=16, le=16384, description="rows of the detector")
    pixel_pitch_x_m: Positive = Field(8.6e-6, description="column pitch [m]")
    pixel_pitch_y_m: Positive = Field(8.3e-6, description="row pitch [m]")
    focal_length_m: Positive = Field(20.19e-3, description="focal length [m]")
    f_number: Positive = Field(2.8, description="focal length over entrance pupil diameter")
    lens_transmission: Fraction = Field(0.35, description="throughput of lens and filter holder, without the filter")
    psf_sigma_px: float = Field(
        0.5, ge=0, le=20, description="standard deviation of the lens's Gaussian point spread, before the pixel [px]"
    )

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal length in columns and in rows [px]."""
        return self.focal_length_m / self.pixel_pitch_x_m, self.focal_length_m / self.pixel_pitch_y_m

    @property
    def principal_point_px(self) -> tuple[float, float]:
        """Centre of the detector, ((W−1)/2, (H−1)/2) [px]."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    @property
    def matrix(self) -> FloatArray:
        """Intrinsic matrix K, (3, 3) [px]."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def pixel_area_m2(self) -> float:
        """Area of one pixel [m²], fill factor 1."""
        return self.pixel_pitch_x_m * self.pixel_pitch_y_m

    def project(self, points_camera_m: ArrayLike) -> FloatArray:
        """Image positions (..., 2) [px] of points (..., 3) in the camera frame [m]."""
        points = np.asarray(points_camera_m, float)
        return points[..., :2] / points[..., 2:] * self.focal_px + self.principal_point_px

    def relative_illumination(self) -> FloatArray:
        """Natural fall-off cos⁴ of the field angle at every pixel, (height, width)."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        x = (np.arange(self.width_px) - cx) / fx
        y = (np.arange(self.height_px) - cy) / fy
        return (1.0 + x**2 + y[:, None] ** 2) ** -2
