"""Calibration of a marker's encoding elements from images of it: where they stand, and how deep their virtual lines lie.

Printing and mounting leave an element beside its place. All blobs of one element then are off together, which no single image
can tell from another attitude; several can. Every image's pose and the elements' offsets are solved in one joint least squares
over corners and blobs, each weighted by its own covariance.

Gauge: the marker frame, its scale included, is the printed ArUco's, whose four corners count as exact. Across an element nothing
of its place can be seen, for slats and virtual line run that way. Where the poses are unknown, a common shift of two opposite
elements is told from a turn of the marker by the corners' perspective alone: that takes tilted views, and the covariance says how
well it went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from detector.features import Features
from detector.pose.pose import solve_pose
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES, MarkerDesign

MAX_ITERATIONS = 50
#: Steps of the numerical derivatives: angles [rad] and lengths relative to the marker's size.
STEP_RAD, STEP_PART = 1e-6, 1e-6
#: The fit ends when a step lowers chi-square by less than this part.
CONVERGED = 1e-9

#: A known pose: rotation (3, 3) and translation (3,) [m], marker -> camera.
KnownPose = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class ElementCalibration:
    """What images say of a marker's elements."""

    offsets_m: FloatArray
    """How far the top, right, bottom and left element stand off their designed places, to the right or up, (4,) [m]."""
    virtual_depth_m: float
    """Depth of the virtual lines below the front plane [m]."""
    covariance: FloatArray
    """Of the offsets and the depth, (5, 5) [m²], unknown poses marginalised; widened by the reduced chi-square above 1."""
    rotations: FloatArray
    """Attitudes of the images used, (n, 3, 3), as solved or as given."""
    translations_m: FloatArray
    """Translations of the images used, (n, 3)."""
    reduced_chi2: float
    """Residual chi-square over degrees of freedom; about 1 when the features' covariances are right."""
    used: tuple[int, ...]
    """Indices of the observations with corners and at least one blob."""

    @property
    def sigma_m(self) -> FloatArray:
        """Standard deviations of the offsets and the depth, (5,) [m]."""
        return np.sqrt(np.diag(self.covariance))

    def marker(self, design: MarkerDesign) -> MarkerDesign:
        """The marker as built: the design with these offsets and this depth."""
        depth = self.virtual_depth_m / design.element_length_m
        return MarkerDesign.model_validate(
            {
                **design.model_dump(),
                "element_offsets_m": tuple(float(o) for o in self.offsets_m),
                "virtual_depth_fraction": depth,
            }
        )


def calibrate_elements(
    observations: Sequence[Features], marker: MarkerDesign, camera: Camera, poses: Sequence[KnownPose] | None = None
) -> ElementCalibration:
    """Offsets of the elements and their virtual depth from what was found in several images.

    The detector's blob model knows where the slits are, so features found with the design at hand are slightly off where an
    element is misplaced: find them again with `ElementCalibration.marker` and calibrate once more. Offsets in `marker` are where
    the search starts, not added to the result.

    Args:
        marker: the design at hand, where the search starts.
        observations: features of each image; those without corners or blobs are passed over.
        camera: of the images; its distortion is heeded.
        poses: known pose of each image, as exact; absent, they are solved along.

    Raises:
        ValueError: when the images do not tell an element's offset or the depth.
    """
    if poses is not None and len(poses) != len(observations):
        raise ValueError(f"poses: {len(poses)}, expected one for each of {len(observations)} observations")
    used, starts = [], []
    for index, found in enumerate(observations):
        if found.corners_px is None or not any(place is not None for place in found.blobs_px.values()):
            continue
        start = poses[index] if poses is not None else _pose_of(found, marker, camera)
        if start is not None:
            used.append(index)
            starts.append(start)
    seen = {name for index in used for name, place in observations[index].blobs_px.items() if place is not None}
    if missing := [name for name in ELEMENT_NAMES if name not in seen]:
        raise ValueError(
            f"observations: no blob of {', '.join(missing)} in {len(used)} images; expected every element in some"
        )
    problem = _Joint([observations[index] for index in used], marker, camera)
    rotation, translation = (np.array([start[k] for start in starts], float) for k in range(2))
    built = np.append(marker.element_offsets_m, marker.elements[0].virtual_depth_m).astype(float)
    return _solve(problem, rotation, translation, built, poses is not None, tuple(used))


def _pose_of(found: Features, marker: MarkerDesign, camera: Camera) -> KnownPose | None:
    pose = solve_pose(found, marker, camera)
    return None if pose is None else (pose.rotation, pose.translation_m)


def _solve(
    problem: _Joint,
    rotation: FloatArray,
    translation: FloatArray,
    built: FloatArray,
    known: bool,
    used: tuple[int, ...],
) -> ElementCalibration:
    """Levenberg–Marquardt over the elements, the poses eliminated image by image."""
    residual = problem.residuals(rotation, translation, built)
    cost, damping = float((residual**2).sum()), 1e-3
    for _ in range(MAX_ITERATIONS):
        by_pose, by_element = problem.derivatives(rotation, translation, built)
        step, turns = _step(residual, by_pose, by_element, damping, known)
        trial = _moved(rotation, turns[:, :3]), translation + turns[:, 3:], built + step
        changed = problem.residuals(*trial)
        new = float((changed**2).sum())
        if not new < cost:
            damping *= 10
            if damping > 1e8:
                break
            continue
        done = cost - new < CONVERGED * cost
        (rotation, translation, built), residual, cost, damping = trial, changed, new, damping / 10
        if done:
            break
    by_pose, by_element = problem.derivatives(rotation, translation, built)
    information = _reduced(by_pose, by_element, 0.0, known)[0]
    freedom = problem.count - 5 - (0 if known else 6 * len(rotation))
    if freedom < 1:
        raise ValueError(
            f"observations: {problem.count} coordinates in {len(rotation)} images are too few; expected more images"
        )
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(scale, scale)
    if not np.linalg.eigvalsh(scaled)[0] > 1e-10:
        raise ValueError(
            "observations: the images do not determine offsets and depth; expected views from several sides"
        )
    reduced = cost / freedom
    covariance = np.linalg.inv(scaled) / np.outer(scale, scale) * max(1.0, reduced)
    return ElementCalibration(
        offsets_m=built[:4],
        virtual_depth_m=float(built[4]),
        covariance=covariance,
        rotations=rotation,
        translations_m=translation,
        reduced_chi2=reduced,
        used=used,
    )


def _reduced(
    by_pose: FloatArray, by_element: FloatArray, damping: float, known: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information (5, 5) about the elements with the poses marginalised; coupling (n, 6, 5) and pose information (n, 6, 6)."""
    across = by_element.transpose(0, 2, 1)
    total = (across @ by_element).sum(axis=0)
    coupling = by_pose.transpose(0, 2, 1) @ by_element
    own = by_pose.transpose(0, 2, 1) @ by_pose
    own = own + damping * own * np.eye(6)
    total = total + damping * total * np.eye(5)
    if not known:
        total = total - (coupling.transpose(0, 2, 1) @ np.linalg.solve(own, coupling)).sum(axis=0)
    return total, coupling, own


def _step(
    residual: FloatArray, by_pose: FloatArray, by_element: FloatArray, damping: float, known: bool
) -> tuple[FloatArray, FloatArray]:
    """Change of the elements (5,) and of the poses (n, 6)."""
    total, coupling, own = _reduced(by_pose, by_element, damping, known)
    pull = -(by_element.transpose(0, 2, 1) @ residual[..., None])[..., 0].sum(axis=0)
    if known:
        return np.linalg.lstsq(total, pull, rcond=None)[0], np.zeros((len(residual), 6))
    pose_pull = -(by_pose.transpose(0, 2, 1) @ residual[..., None])
    pull = pull - (coupling.transpose(0, 2, 1) @ np.linalg.solve(own, pose_pull))[..., 0].sum(axis=0)
    step = np.linalg.lstsq(total, pull, rcond=None)[0]
    return step, np.linalg.solve(own, pose_pull - (coupling @ step)[..., None])[..., 0]


def _moved(rotation: FloatArray, turn: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(turn).as_matrix() @ rotation


class _Joint:
    """Whitened residuals (images, 12) of corners and blobs, zero where a blob was not found, and their derivatives."""

    def __init__(self, observations: list[Features], marker: MarkerDesign, camera: Camera):
        self.marker, self.camera = marker, camera
        self.corners_px = np.array([found.corners_px for found in observations])
        self.whiten = np.array(
            [np.linalg.inv(np.linalg.cholesky(found.corner_covariance_px2)) for found in observations]
        )
        nowhere = np.full(2, np.nan)
        self.blobs_px = np.array(
            [
                [p if (p := found.blobs_px[name]) is not None else nowhere for name in ELEMENT_NAMES]
                for found in observations
            ]
        )
        self.sigma = np.array(
            [[found.blob_sigma_px.get(name, np.inf) for name in ELEMENT_NAMES] for found in observations]
        )
        self.found = np.isfinite(self.blobs_px).all(axis=-1)
        self.along = np.array([e.along for e in marker.elements])
        self.centre = np.array([e.centre_m for e in marker.elements])
        self.designed = np.array([e.virtual_offset_m - e.shift_m for e in marker.elements])
        #: Coordinates that were measured.
        self.count = 8 * len(observations) + int(self.found.sum())

    def residuals(self, rotation: FloatArray, translation: FloatArray, built: FloatArray) -> FloatArray:
        corners = self._image(self.marker.corners_m, rotation, translation)
        of_corners = (self.whiten @ (self.corners_px - corners).reshape(-1, 8, 1))[..., 0]
        camera = -np.einsum("nji,nj->ni", rotation, translation)
        line, depth = self.designed + built[:4], built[4]
        u = line + (camera @ self.along.T - line) * depth / (depth + camera[:, 2:])
        step = 1e-5 * self.marker.size_m
        place, beside = (
            self._image(self.centre + (u + more)[..., None] * self.along, rotation, translation) for more in (0.0, step)
        )
        direction = (beside - place) / np.linalg.norm(beside - place, axis=-1, keepdims=True)
        off = np.where(self.found, ((self.blobs_px - place) * direction).sum(axis=-1), 0.0)
        return np.concatenate([of_corners, off / self.sigma], axis=1)

    def _image(self, points_m: FloatArray, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Image positions (n, 4, 2) of points (4, 3) or (n, 4, 3) of the marker frame."""
        return self.camera.project(points_m @ rotation.transpose(0, 2, 1) + translation[:, None])

    def derivatives(
        self, rotation: FloatArray, translation: FloatArray, built: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """By (ω, t) of each image, (n, 12, 6), and by offsets and depth, (n, 12, 5); central differences."""
        length = STEP_PART * self.marker.size_m
        by_pose, changes = [], np.diag([STEP_RAD] * 3 + [length] * 3)
        for change in changes:
            ends = [
                self.residuals(_moved(rotation, s * change[:3]), translation + s * change[3:], built) for s in (1, -1)
            ]
            by_pose.append((ends[0] - ends[1]) / (2 * change.sum()))
        by_element = [
            (self.residuals(rotation, translation, built + c) - self.residuals(rotation, translation, built - c))
            / (2 * length)
            for c in length * np.eye(5)
        ]
        return np.stack(by_pose, axis=-1), np.stack(by_element, axis=-1)
