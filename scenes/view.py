"""What is rendered, how densely, and what comes out of it: plain data, without Mitsuba."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from radiometry.geometry import FloatArray, attitude_matrix, sun_direction
from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.target import Target

MM_PER_M = 1000.0
LIGHTS = ("led", "sun")
#: Unit of each light's basis; the Earth's is rendered where there is one.
UNITS = {"led": "m-2", "sun": "sr-1", "earth": "1"}
#: Fields of the camera that act on the rendered radiance, not on its transport. The focus acts through the point spread, which
#: a view's camera already holds (`radiometry.optics.camera_at`).
AFTER_TRANSPORT = frozenset(
    {"f_number", "lens_transmission", "focus_m", "vignetting", "veiling_glare", "point_source_transmittance"}
)


@dataclass(frozen=True)
class View:
    """One geometry to be rendered: everything that changes transport, and nothing else.

    Attributes:
        camera: as it images the range (`radiometry.optics.camera_at`).
        marker: the design.
        target: the face behind it, and the attitude of both.
        leds: illuminator around the lens.
        sun: direction and distance of the Sun.
        range_m: distance of the marker along the optical axis [m].
        nodes_nm: wavelengths, in groups of four [nm].
        earth: the sunlit Earth, or None.
    """

    camera: Camera
    marker: MarkerDesign
    target: Target
    leds: LedRing
    sun: Sun
    range_m: float
    nodes_nm: tuple[int, ...]
    earth: Earth | None = None
    #: Diameter of the disc as which the lens images a point of the marker's range [px]; the camera's point spread is the whole
    #: blur, this disc included.
    defocus_px: float = 0.0

    @property
    def lights(self) -> tuple[str, ...]:
        """Lights that have a basis, keys of `UNITS`."""
        return LIGHTS if self.earth is None else (*LIGHTS, "earth")

    @cached_property
    def rotation(self) -> FloatArray:
        """Rotation from the marker frame to the camera frame, (3, 3)."""
        return attitude_matrix(*np.radians([self.target.pitch_deg, self.target.yaw_deg, self.target.roll_deg]))

    @cached_property
    def translation_m(self) -> FloatArray:
        """Marker's origin in the camera frame, (3,) [m]: at the range along the axis, and beside it as the target says."""
        return np.array([self.target.offset_x_m, self.target.offset_y_m, self.range_m])

    @cached_property
    def sun_in_marker(self) -> FloatArray:
        """Unit vector target -> Sun in the marker frame, (3,)."""
        return self.rotation.T @ sun_direction(np.radians(self.sun.phase_deg), np.radians(self.sun.azimuth_deg))

    @cached_property
    def earth_in_marker(self) -> FloatArray:
        """Unit vector target -> centre of the Earth in the marker frame, (3,); needs an Earth."""
        assert self.earth is not None
        there = sun_direction(np.radians(self.earth.phase_deg), np.radians(self.earth.azimuth_deg))
        return self.rotation.T @ there

    def to_marker(self, points_camera_m: FloatArray) -> FloatArray:
        """Points of the camera frame in the marker frame.

        Args:
            points_camera_m: (..., 3) [m].

        Returns:
            (..., 3) [m].
        """
        return (points_camera_m - self.translation_m) @ self.rotation

    def to_image(self, points_marker_m: FloatArray) -> FloatArray:
        """Image positions of points of the marker frame.

        Args:
            points_marker_m: (..., 3) [m].

        Returns:
            (..., 2) as column and row [px].
        """
        return self.camera.project(points_marker_m @ self.rotation.T + self.translation_m)

    def to_plane(self, image_px: FloatArray) -> FloatArray:
        """Where lines of sight meet the marker's plane.

        Args:
            image_px: positions in the image, (n, 2) as column and row [px].

        Returns:
            x and y in the marker frame, (n, 2) [m].
        """
        homography = self.camera.matrix @ np.column_stack([self.rotation[:, :2], self.translation_m])
        ideal_px = self.camera.undistort_px(image_px)
        points = np.column_stack([ideal_px, np.ones(len(ideal_px))]) @ np.linalg.inv(homography).T
        return points[:, :2] / points[:, 2:]


@dataclass(frozen=True)
class Quality:
    """How densely a view is sampled.

    The density on the marker follows from the charge that its pixels can hold (`scenes.render.density`). That of the frame
    is given.

    Attributes:
        frame_samples: rays along one side of a pixel outside the marker; 0 leaves the frame dark there.
        marker_rays: most rays to spend on the marker's surroundings.
        seed: of the lattices' shifts.
        electrons: charge of the brightest pixels with whose shot noise the renderer's noise is compared [electrons].
        variance_fraction: largest ratio of the renderer's variance to shot variance on the marker's pixels.
    """

    frame_samples: int = 1
    marker_rays: int = 4_000_000
    seed: int = 1
    electrons: float = 20_000.0
    variance_fraction: float = 0.1


@dataclass(frozen=True)
class Region:
    """A rectangle of whole pixels.

    Attributes:
        x0, y0: its first column and row.
        width, height: number of columns and rows.
        samples: sub-pixels along one side of each pixel.
    """

    x0: int
    y0: int
    width: int
    height: int
    samples: int


@dataclass(frozen=True)
class TransportBasis:
    """Basis images of one view.

    Attributes:
        nodes_nm: wavelengths [nm].
        layers: by light, (nodes, height, width) float32 in the units of `UNITS`.
        attributes: provenance, string or number.
        noise: by light, one sample (height, width) of the error of the layers, in the same units: half the difference of
            two independent renderings whose mean the layers are, averaged over the wavelengths. The mean of its square is
            the variance of the layers. It is zero away from ArUco and elements, where there is only one rendering, and
            absent where nothing is known.
    """

    nodes_nm: tuple[int, ...]
    layers: dict[str, NDArray[np.float32]]
    attributes: dict[str, str | float] = field(default_factory=dict)
    noise: dict[str, NDArray[np.float32]] = field(default_factory=dict)
