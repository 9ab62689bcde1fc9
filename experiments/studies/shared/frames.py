"""Frames of one geometry at any sub-pixel position: the transport rendered before the lens's blur, and the exposure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from detector.pose.bounds import Exposure, FineImage, Orbit
from experiments import chain
from experiments.scenario import Scenario
from experiments.studies.shared.truth import Truth
from radiometry.geometry import FloatArray
from radiometry.optics import camera_at

#: Sub-pixels along a pixel's side. A point spread of half a pixel passes nothing that so many cannot carry.
SAMPLES = 4
#: Rays a sub-pixel of the marker: where features are measured, and where only derivatives are wanted. All sub-pixels share their
#: places, and with few rays these are off the middle by a good part of a sub-pixel: the image is then moved by as much.
RAYS, RAYS_OF_BOUNDS = 32, 4
#: Pixels around the marker, so that the detector's windows meet what is there in a whole frame.
MARGIN_PX = 12
#: Half steps of the central differences, as a motion of a blob in the image [px] and as a change of scale at the outline [px].
BLOB_STEP_PX, SCALE_STEP_PX = 0.2, 0.2


def around_marker(scenario: Scenario, margin_px: int = MARGIN_PX) -> Scenario:
    """The scenario with its detector cropped, about the same axis, to the marker and a margin [px]."""
    seen = chain.view(scenario)
    half = scenario.marker.size_m / 2
    outline = seen.to_image(half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]))
    reach = np.abs(outline - scenario.camera.principal_point_px).max(axis=0) + margin_px
    crop = {}
    for key, out in zip(("width_px", "height_px"), reach, strict=True):
        full = getattr(scenario.camera, key)
        # Taking as much on either side keeps the axis where it is between pixels.
        crop[key] = min(full, full % 2 + 2 * int(np.ceil(out)))
    return scenario.at(camera={**scenario.camera.model_dump(), **crop})


def fine_frames(scenarios: Sequence[Scenario], illumination: str, rays: int = RAYS) -> list[FineImage]:
    """Electron rates of scenarios' frames before the lens's blur, on sub-pixels of so many rays each; rendered together."""
    dense = [_dense(scenario, rays) for scenario in scenarios]
    frames = []
    for scenario, fine, basis in zip(scenarios, dense, chain.transports(dense), strict=True):
        blur = camera_at(scenario.camera, scenario.range_m, scenario.filter.centre_nm).psf_sigma_px
        frames.append(FineImage(chain.electron_rate(fine, basis, illumination) * SAMPLES**2, SAMPLES, blur))
    return frames


def _dense(scenario: Scenario, rays: int) -> Scenario:
    """The scenario with an ideal lens and sub-pixels for pixels."""
    camera = scenario.camera
    width, height = camera.width_px * SAMPLES, camera.height_px * SAMPLES
    fine = {
        "width_px": width,
        "height_px": height,
        "pixel_pitch_x_m": camera.pixel_pitch_x_m / SAMPLES,
        "pixel_pitch_y_m": camera.pixel_pitch_y_m / SAMPLES,
        "psf_sigma_px": 0.0,
        "focus_m": None,
    }
    budget = int(np.clip(rays * width * height, 10_000, 50_000_000))
    render = {**scenario.render.model_dump(), "frame_samples": 2, "marker_rays": budget}
    return scenario.at(camera={**camera.model_dump(), **fine}, render=render)


@dataclass(frozen=True)
class Case:
    """A geometry rendered once, its exposure, and what the bounds need beside it."""

    scenario: Scenario
    fine: FineImage
    exposure: Exposure
    truth: Truth

    @classmethod
    def of(cls, scenario: Scenario, illumination: str = "eclipse") -> Case:
        """Render a scenario, cropped to the marker, and choose its exposure."""
        cropped = around_marker(scenario)
        seconds = chain.solve_exposure(cropped, chain.link_budget(cropped, illumination), cropped.exposure_s)
        sensor = cropped.sensor
        exposure = Exposure(seconds, sensor.dark_electrons(seconds), sensor.total_noise_electrons)
        return cls(cropped, fine_frames([cropped], illumination)[0], exposure, Truth.of(cropped))

    def orbit(self, illumination: str = "eclipse") -> Orbit:
        """The marker from a little aside: pitch, yaw and range before and after."""
        marker, target, range_m = self.scenario.marker, self.scenario.target, self.scenario.range_m
        focal = min(self.scenario.camera.focal_px)
        depth = marker.elements[0].virtual_depth_m
        angle = BLOB_STEP_PX * range_m / (focal * depth)
        step = SCALE_STEP_PX * range_m**2 / (focal * marker.size_m / 2)

        def turned(key: str, by: float) -> Scenario:
            return self.scenario.at(target={**target.model_dump(), key: getattr(target, key) + np.degrees(by)})

        sides = [turned(key, sign * angle) for key in ("pitch_deg", "yaw_deg") for sign in (-1, 1)]
        sides += [self.scenario.at(range_m=range_m + sign * step) for sign in (-1, 1)]
        frames = fine_frames(sides, illumination, RAYS_OF_BOUNDS)
        return Orbit(tuple(zip(frames[::2], frames[1::2], strict=True)), (angle, angle, step), self._turns())

    def beside(self, illumination: str = "eclipse") -> tuple[FineImage, FineImage, float]:
        """Frames with every blob a little earlier and later along its element, and half of the way between them [m].

        The virtual lines move, the openings stay.
        """
        marker, view = self.scenario.marker, self.truth.view
        camera = view.to_marker(np.zeros(3))
        scale = min(float(np.linalg.norm(v)) for v in self.truth.along_px.values())
        step = BLOB_STEP_PX / scale
        depth = marker.elements[0].virtual_depth_m
        share = step * (depth + camera[2]) / camera[2] / marker.element_length_m
        sides = []
        for sign in (-1, 1):
            part = marker.virtual_offset_fraction + sign * share
            sides.append(self.scenario.at(marker={**marker.model_dump(), "virtual_offset_fraction": part}))
        before, after = fine_frames(sides, illumination, RAYS_OF_BOUNDS)
        return before, after, step

    def _turns(self) -> FloatArray:
        from radiometry.geometry import attitude_matrix

        angles = np.radians([getattr(self.scenario.target, f"{key}_deg") for key in ("pitch", "yaw", "roll")])
        base, step, turns = attitude_matrix(*angles), 1e-6, []
        for axis in range(2):
            change = np.zeros(3)
            change[axis] = step
            spin = (attitude_matrix(*(angles + change)) - attitude_matrix(*(angles - change))) @ base.T / (2 * step)
            turns.append([spin[2, 1], spin[0, 2], spin[1, 0]])
        return np.array(turns)
