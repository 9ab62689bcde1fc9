"""The marker's field of view by rendering: what is found in frames over pitch × yaw, and an element's light along one cut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import xarray as xr

from experiments import chain
from experiments.chain.progress import Progress
from experiments.chain.statistics import root_mean_square
from experiments.scenario import Scenario
from experiments.thesis.fov.plan import Plan
from radiometry.geometry import FloatArray
from scenes.marker import ELEMENT_NAMES, Element
from scenes.render.transport import TransportBasis
from scenes.view import View


@dataclass(frozen=True)
class FovResult:
    """What the study finds.

    Attributes:
        scenario: camera, LEDs and marker of the system.
        data: groups 'map' and 'cut'; see `map_of` and `cut_of`.
    """

    scenario: Scenario
    data: xr.DataTree

    @property
    def map(self) -> xr.Dataset:
        """What is found over pitch and yaw."""
        return self.data["map"].to_dataset()

    @property
    def cut(self) -> xr.Dataset:
        """One cut over yaw."""
        return self.data["cut"].to_dataset()


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None) -> FovResult:
    """Render the map and the cut, and detect in their frames."""
    tree = xr.DataTree.from_dict({"map": map_of(scenario, plan, progress), "cut": cut_of(scenario, plan, progress)})
    tree.attrs |= chain.provenance(scenario)
    return FovResult(scenario, tree)


_LIGHT = {"units": "1", "long_name": "light of an element over that of a whole floor of tape"}
_CENTROID = {"units": "m", "long_name": "error of a plain centroid along the element"}
#: Variables of the map with their attributes.
_MAPPED: dict[str, dict[str, str]] = {
    "corners": {"units": "1"},
    "virtual": {"units": "1"},
    "pose": {"units": "1"},
    "blob": {"units": "1"},
    "blob_px": {"units": "pixel", "long_name": "rms error of a blob along its element"},
    "light": _LIGHT,
    "centroid_m": _CENTROID,
    "attitude_deg": {"units": "deg", "long_name": "median geodesic attitude error"},
}
#: A neighbourhood of the opening from which its blurred light is taken: point spread and pixel [px].
_SPILL_PX = 1.5


def framed(scenario: Scenario, range_m: float, pitch_deg: float, yaw_deg: float, rays: int) -> Scenario:
    """The scenario at a tilt, seen by the middle of its detector: as many pixels as the marker needs.

    The axis, about which a lens distorts, stays in the middle of the cropped detector.
    """
    camera = scenario.camera
    size = max(32, 2 * int(np.ceil((0.65 * scenario.marker.size_m / range_m) * max(camera.focal_px))) + 16)
    width, height = min(size, camera.width_px), min(size, camera.height_px)
    return scenario.at(
        range_m=range_m,
        illumination="eclipse",
        camera={**camera.model_dump(), "width_px": width, "height_px": height},
        target={**scenario.target.model_dump(), "pitch_deg": pitch_deg, "yaw_deg": yaw_deg},
        render={**scenario.render.model_dump(), "marker_rays": rays, "frame_samples": 1},
    )


def blob_truth_px(view: View, element: Element) -> FloatArray:
    """Where an element's blob is by geometry, (2,) [px]."""
    camera_m = view.to_marker(np.zeros(3))
    return view.to_image(element.centre_m + element.blob_offset_m(camera_m) * element.along)


def _axis_px(view: View, element: Element) -> FloatArray:
    """Direction of an element in the image at its blob, (2,) [px/m]."""
    step = 1e-4
    middle = element.centre_m + element.blob_offset_m(view.to_marker(np.zeros(3))) * element.along
    ends = view.to_image(np.stack([middle - step * element.along, middle + step * element.along]))
    return (ends[1] - ends[0]) / (2 * step)


def map_of(scenario: Scenario, plan: Plan, progress: Progress | None = None) -> xr.Dataset:
    """What is found over pitch × yaw at each range, LEDs alone; dimensions range_m, pitch_deg, yaw_deg (, element).

    Without noise: light and centroid_m of each element, see `cut_of`. Shares of the noise draws: corners (marker decoded), blob
    by element, virtual (a virtual point, so six degrees of freedom without the flip of a plane), pose; rms errors blob_px and
    medians attitude_deg, NaN where never found.
    """
    grid = np.array(plan.grid_deg)
    shape = (len(plan.ranges_m), len(grid), len(grid))
    cases = [
        framed(scenario, plan.ranges_m[i], float(grid[j]), float(grid[k]), plan.rays) for i, j, k in np.ndindex(shape)
    ]
    tilts = []
    for here, basis in zip(cases, chain.transports(cases), strict=True):
        tilts.append(_tilt(here, basis, plan.draws))
        if progress is not None:
            progress(len(tilts), len(cases), "tilts")
    dims = ("range_m", "pitch_deg", "yaw_deg")
    data: dict[str, Any] = {}
    for name, attributes in _MAPPED.items():
        values = np.array([tilt[name] for tilt in tilts])
        by_element = values.ndim > 1
        data[name] = (
            (*dims, "element") if by_element else dims,
            values.reshape((*shape, 4) if by_element else shape),
            attributes,
        )
    coordinates = {
        "range_m": ("range_m", list(plan.ranges_m), {"units": "m"}),
        "pitch_deg": ("pitch_deg", grid, {"units": "deg"}),
        "yaw_deg": ("yaw_deg", grid, {"units": "deg"}),
        "element": list(ELEMENT_NAMES),
    }
    return xr.Dataset(data, coordinates, {"draws": plan.draws})


def _tilt(here: Scenario, basis: TransportBasis, draws: int) -> dict[str, Any]:
    """Values of `_MAPPED` at one tilt."""
    rate, seconds, tape_rate = _exposed(here, basis)
    view = chain.view(here)
    truth = {e.name: blob_truth_px(view, e) for e in here.marker.elements}
    axis = {e.name: _axis_px(view, e) for e in here.marker.elements}
    off: list[list[float]] = [[] for _ in ELEMENT_NAMES]
    attitudes_deg = []
    counts = dict.fromkeys(("corners", "virtual", "pose"), 0)
    for trial in range(draws):
        detection = chain.detect(here, chain.expose(here, rate, "eclipse", seconds, trial).dn)
        found = detection.features
        counts["corners"] += found.detected
        counts["virtual"] += bool(found.virtual_points_px)
        counts["pose"] += detection.pose is not None
        for n, name in enumerate(ELEMENT_NAMES):
            position = found.blobs_px.get(name)
            if position is not None:
                off[n].append(float((position - truth[name]) @ axis[name] / np.linalg.norm(axis[name])))
        if detection.pose is not None:
            attitudes_deg.append(np.degrees(chain.pose_errors(here, detection.pose)[0]))
    elements = [_light_and_centroid(rate, view, element, tape_rate) for element in here.marker.elements]
    return {
        **{name: count / draws for name, count in counts.items()},
        "blob": [len(errors) / draws for errors in off],
        "blob_px": [root_mean_square(errors) for errors in off],
        "light": [light for light, _ in elements],
        "centroid_m": [centroid for _, centroid in elements],
        "attitude_deg": np.median(attitudes_deg) if attitudes_deg else np.nan,
    }


def _exposed(here: Scenario, basis: TransportBasis) -> tuple[FloatArray, float, float]:
    """Mean electron rate (height, width) [1/s], automatic exposure [s], and rate of a pixel full of lit tape [1/s]."""
    budget = chain.link_budget(here, "eclipse")
    rate = chain.electron_rate(here, basis, "eclipse")
    return rate, chain.solve_exposure(here, budget, "auto"), budget.tape_rate


def cut_of(scenario: Scenario, plan: Plan, progress: Progress | None = None) -> xr.Dataset:
    """Light and centroid of each element over yaw at no pitch, at the first range; dimensions yaw_deg, element.

    Variables: light, over that of a floor of tape in the whole opening, and centroid_m, error along the element of the centre of
    gravity above half the peak, as a blob detector has it, both without noise; found, share of noisy frames in which the
    project's detector has the blob. For top and bottom the cut runs along the element, for the others across.
    """
    yaw = np.array(plan.cut_deg)
    light, centroid, seen = np.zeros((len(yaw), 4)), np.full((len(yaw), 4), np.nan), np.zeros((len(yaw), 4))
    cases = [framed(scenario, plan.ranges_m[0], 0.0, float(angle), 2 * plan.rays) for angle in yaw]
    for k, (here, basis) in enumerate(zip(cases, chain.transports(cases), strict=True)):
        rate, seconds, tape_rate = _exposed(here, basis)
        view = chain.view(here)
        for n, element in enumerate(here.marker.elements):
            light[k, n], centroid[k, n] = _light_and_centroid(rate, view, element, tape_rate)
        for trial in range(plan.draws):
            blobs = chain.detect(here, chain.expose(here, rate, "eclipse", seconds, trial).dn).features.blobs_px
            seen[k] += [blobs.get(name) is not None for name in ELEMENT_NAMES]
        if progress is not None:
            progress(k + 1, len(yaw), "cut")
    dims = ("yaw_deg", "element")
    share = {"units": "1", "long_name": "share of noisy frames in which the blob is found"}
    data = {
        "light": (dims, light, _LIGHT),
        "centroid_m": (dims, centroid, _CENTROID),
        "found": (dims, seen / plan.draws, share),
    }
    return xr.Dataset(data, {"yaw_deg": ("yaw_deg", yaw, {"units": "deg"}), "element": list(ELEMENT_NAMES)})


def _light_and_centroid(rate: FloatArray, view: View, element: Element, tape_rate: float) -> tuple[float, float]:
    """Light of an opening over a floor of tape's, and the centroid's error along the element [m]; NaN without light."""
    half = element.length_m / 2 * element.along, element.width_m / 2 * element.across
    corners = np.array([element.centre_m + a * half[0] + b * half[1] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    outline = view.to_image(corners)
    area = float(cv2.contourArea(outline.astype(np.float32)))
    middle = outline.mean(axis=0)
    reach = np.linalg.norm(outline - middle, axis=1, keepdims=True)
    grown = middle + (outline - middle) * (1 + _SPILL_PX / reach)
    mask = cv2.fillConvexPoly(np.zeros(rate.shape, np.uint8), np.round(grown * 16).astype(np.int32), 1, shift=4) > 0
    inside = np.where(mask, rate, 0.0)
    share = float(inside.sum() / (tape_rate * area)) if area > 0 and tape_rate > 0 else float("nan")
    peak = float(inside.max())
    if peak < 0.05 * tape_rate:
        return share, float("nan")
    weight = np.clip(inside - 0.5 * peak, 0, None)
    row, column = np.nonzero(weight)
    centre = np.array([column, row]) @ weight[row, column] / weight.sum()
    axis = _axis_px(view, element)
    return share, float((centre - blob_truth_px(view, element)) @ axis / (axis @ axis))
