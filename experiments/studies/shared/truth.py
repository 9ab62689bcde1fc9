"""What a frame truly shows: the one reference that detections and poses are compared with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from detector.elements.blobs import MAX_CUT_FRACTION
from detector.elements.slits import Slits
from detector.features import Features
from experiments import chain
from experiments.scenario import Scenario
from experiments.studies.shared.trackers import Design
from radiometry.geometry import FloatArray
from scenes.marker import ELEMENT_NAMES, MarkerDesign
from scenes.tags import DotPlate
from scenes.view import View

#: Rows and columns of pixels.
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]

#: A detection whose corners are further off than this, rms and in bits, is of something else.
MISPLACED_BITS = 1.0
#: Step along an element over which its image is differentiated [m].
_STEP_M = 1e-6


@dataclass(frozen=True)
class Truth:
    """Where the features of a target are in the image.

    Attributes:
        design: the target that the frame shows.
        view: its attitude and place, and the camera.
    """

    design: Design
    view: View

    @classmethod
    def of(cls, scenario: Scenario) -> Truth:
        """The truth of a scenario's frames."""
        return cls(scenario.marker, chain.view(scenario))

    @cached_property
    def marker(self) -> MarkerDesign:
        """The design, where it is a marker with encoding elements.

        Raises:
            TypeError: for any other design.
        """
        if not isinstance(self.design, MarkerDesign):
            raise TypeError(f"{type(self.design).__name__} has no encoding elements")
        return self.design

    @cached_property
    def points_px(self) -> FloatArray:
        """Feature points (n, 2), corners first [px]."""
        points = self.design.points_m if isinstance(self.design, DotPlate) else self.design.corners_m
        return self.view.to_image(points)

    @cached_property
    def corners_px(self) -> FloatArray:
        """Corners (4, 2) of the marker's ArUco [px]."""
        return self.view.to_image(self.marker.corners_m)

    @cached_property
    def side_px(self) -> float:
        """Side of the coded square, seen frontally [px]."""
        return self.design.aruco_m * float(np.mean(self.view.camera.focal_px)) / self.view.range_m

    @cached_property
    def px_per_bit(self) -> float:
        """Pixels along the shorter side of a bit as it is seen."""
        return self.design.bit_m * min(chain.bit_scale_px(self.view))

    @cached_property
    def white_bits(self) -> Pixels:
        """Pixels of the bright bits."""
        return _joined(chain.bit_pixels(self.view, self.marker.white_bit_centres_m()))

    @cached_property
    def black_bits(self) -> Pixels:
        """Pixels of the dark cells beside the bright bits."""
        return _joined(chain.bit_pixels(self.view, self.marker.black_bit_centres_m()))

    def bits(self, image: FloatArray) -> tuple[float, float]:
        """Mean of an image (H, W) over the pixels of the bright bits and over those of the dark cells beside them."""
        return float(image[self.white_bits].mean()), float(image[self.black_bits].mean())

    @cached_property
    def blobs_px(self) -> dict[str, FloatArray]:
        """Blob (2,) of each element [px], whether it lies in the opening or not."""
        return {name: ends[0] for name, ends in self._ends_px.items()}

    @cached_property
    def along_px(self) -> dict[str, FloatArray]:
        """Image (2,) of the unit vector along each element, at its blob [px/m]."""
        return {name: (ends[1] - ends[0]) / _STEP_M for name, ends in self._ends_px.items()}

    @cached_property
    def _ends_px(self) -> dict[str, FloatArray]:
        """Each element's blob, and a point a small step further along the element, (2, 2) [px]."""
        steps = np.array([[0.0], [_STEP_M]])
        return {
            e.name: self.view.to_image(e.centre_m + (float(e.blob_offset_m(self._camera_m)) + steps) * e.along)
            for e in self.marker.elements
        }

    @cached_property
    def blob_width_px(self) -> float:
        """Width of the blobs' triangle at half its height, the smallest over the elements [px]."""
        return min(
            float(Slits(self.marker, e, self._camera_m).half_width * np.linalg.norm(self.along_px[e.name]))
            for e in self.marker.elements
        )

    @cached_property
    def blobs_in_openings(self) -> frozenset[str]:
        """Elements whose blob stands in the opening, but for as much as a detector may lose; empty for other designs."""
        if not isinstance(self.design, MarkerDesign):
            return frozenset()
        camera_m = self._camera_m
        return frozenset(
            e.name
            for e in self.design.elements
            if Slits(self.design, e, camera_m).cut_fraction(float(e.blob_offset_m(camera_m))) <= MAX_CUT_FRACTION
        )

    def blob_errors_px(self, features: Features) -> FloatArray:
        """Error of each blob along its element, (4,) in the order of `ELEMENT_NAMES` [px]; NaN where none was found."""
        errors = np.full(len(ELEMENT_NAMES), np.nan)
        for k, name in enumerate(ELEMENT_NAMES):
            found, along = features.blobs_px.get(name), self.along_px[name]
            if found is not None:
                errors[k] = (found - self.blobs_px[name]) @ along / np.linalg.norm(along)
        return errors

    def pose(self, shift_px: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Rotation (3, 3) and translation (3,) [m] of a marker whose image is shifted, as by a slight turn of the camera."""
        from scipy.spatial.transform import Rotation

        fx, fy = self.view.camera.focal_px
        turn = Rotation.from_rotvec([-np.arctan(shift_px[1] / fy), np.arctan(shift_px[0] / fx), 0.0]).as_matrix()
        return turn @ self.view.rotation, turn @ self.view.translation_m

    @cached_property
    def _camera_m(self) -> FloatArray:
        """The camera in the target's frame, (3,) [m]."""
        return self.view.to_marker(np.zeros(3))


def _joined(pixels: list[Pixels]) -> Pixels:
    return np.concatenate([p[0] for p in pixels]), np.concatenate([p[1] for p in pixels])
