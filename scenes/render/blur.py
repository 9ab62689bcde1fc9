"""The lens's blur beyond what the rays are gathered with: a Gaussian and a defocus disc, as one kernel of whole pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from radiometry.geometry import FloatArray
from scenes.render.lattice import REACH_SIGMA

#: A point spread wider than the first [px] is gathered with the second, and the pixels are blurred by the rest. What a pixel of
#: that spread cannot carry, frequencies beyond half a cycle a pixel, is then below 1e-4.
WIDE_PX, BASE_PX = 1.2, 0.8
#: Widest blur that is drawn [px]; the image of a marker is flat long before.
WIDEST_PX = 200.0
#: Sub-pixels along a pixel's side by which the disc's edge is drawn.
_FINE = 8


@dataclass(frozen=True)
class Blur:
    """How a view's point spread is drawn.

    Attributes:
        gathered_px: standard deviation of the Gaussian with which rays are gathered.
        rest_px: standard deviation of what the pixels are blurred by afterwards; 0 for nothing.
        disc_px: diameter of the disc in it.
    """

    gathered_px: float
    rest_px: float
    disc_px: float

    @classmethod
    def of(cls, sigma_px: float, defocus_px: float) -> Blur:
        """The blur of a whole standard deviation, a disc of a diameter included.

        A narrow point spread is a Gaussian as a whole: a disc of four pixels or less, gathered through a pixel and a lens, is
        close to one. Of a wide one the disc is drawn as a disc; where the gathering Gaussian is wider than the lens in focus,
        the disc is made smaller by so much that the whole keeps its variance.
        """
        if sigma_px <= WIDE_PX:
            return cls(sigma_px, 0.0, 0.0)
        rest2 = min(sigma_px, WIDEST_PX) ** 2 - BASE_PX**2
        return cls(BASE_PX, float(np.sqrt(rest2)), min(defocus_px, 4 * float(np.sqrt(rest2))))

    @property
    def reach_px(self) -> int:
        """Pixels on either side that the rest reaches."""
        return int(np.ceil(max(REACH_SIGMA * self.rest_px, self.disc_px / 2 + 1))) if self.rest_px else 0

    def kernel(self) -> NDArray[np.float32]:
        """The rest as a kernel (2r+1, 2r+1) of sum one."""
        reach = self.reach_px
        gaussian_px = float(np.sqrt(max(self.rest_px**2 - self.disc_px**2 / 16, 0.0)))
        if self.disc_px > 0:
            image = _disc(self.disc_px, reach)
        else:
            image = np.zeros((2 * reach + 1, 2 * reach + 1))
            image[reach, reach] = 1.0
        if gaussian_px > 0:
            image = gaussian_filter(image, gaussian_px, mode="constant", truncate=REACH_SIGMA)
        return (image / image.sum()).astype(np.float32)


def _disc(diameter_px: float, reach: int) -> FloatArray:
    """Share of each pixel (2r+1, 2r+1) that a disc about the middle covers."""
    fine = (np.arange((2 * reach + 1) * _FINE) + 0.5) / _FINE - reach - 0.5
    covered = fine[:, None] ** 2 + fine**2 <= (diameter_px / 2) ** 2
    side = 2 * reach + 1
    return covered.reshape(side, _FINE, side, _FINE).mean(axis=(1, 3))
