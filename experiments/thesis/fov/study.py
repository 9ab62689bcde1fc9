"""The marker's field of view by rendering: what is found in frames over pitch × yaw, and an element's light along one cut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import xarray as xr

from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from scenes.marker import ELEMENT_NAMES, Element
from scenes.render.transport import View


@dataclass(frozen=True)
class Plan:
    """What is rendered: ranges, the grid of tilts, noise draws of each, step of the cut, and rays on the marker."""

    ranges_m: tuple[float, ...]
    grid_deg: tuple[float, ...]
    draws: int
    cut_deg: tuple[float, ...]
    rays: int


FULL = Plan((2.0, 5.0), tuple(np.arange(-75.0, 76.0, 5.0)), 4, tuple(np.arange(-70.0, 71.0, 1.0)), 1_000_000)
QUICK = Plan((2.0,), (-40.0, 0.0, 40.0), 1, (-50.0, -30.0, 0.0, 30.0, 50.0), 200_000)


_LIGHT = {"units": "1", "long_name": "light of an element over that of a whole floor of tape"}
_CENTROID = {"units": "m", "long_name": "error of a plain centroid along the element"}


def framed(scenario: Scenario, range_m: float, pitch_deg: float, yaw_deg: float, rays: int) -> Scenario:
    """The scenario at a tilt, seen by the middle of its detector: as many pixels as the marker needs."""
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
    share = {name: np.zeros(shape) for name in ("corners", "virtual", "pose")}
    blob, error = np.zeros((*shape, 4)), np.full((*shape, 4), np.nan)
    light, centroid = np.zeros((*shape, 4)), np.full((*shape, 4), np.nan)
    attitude = np.full(shape, np.nan)
    total = int(np.prod(shape))
    cases = [
        framed(scenario, plan.ranges_m[i], float(grid[j]), float(grid[k]), plan.rays) for i, j, k in np.ndindex(shape)
    ]
    for count, ((i, j, k), here, basis) in enumerate(
        zip(np.ndindex(shape), cases, chain.transports(cases), strict=True)
    ):
        rate = chain.electron_rate(here, basis, "eclipse")
        budget = chain.link_budget(here, "eclipse")
        seconds = chain.solve_exposure(here, budget, "auto")
        view = chain.view(here)
        for n, element in enumerate(here.marker.elements):
            light[i, j, k, n], centroid[i, j, k, n] = _light_and_centroid(rate, view, element, budget.tape_rate)
        truth = {e.name: blob_truth_px(view, e) for e in here.marker.elements}
        axis = {e.name: _axis_px(view, e) for e in here.marker.elements}
        off: list[list[float]] = [[] for _ in ELEMENT_NAMES]
        turned = []
        for trial in range(plan.draws):
            detection = chain.detect(here, chain.expose(here, rate, "eclipse", seconds, trial).dn)
            found = detection.features
            share["corners"][i, j, k] += found.detected
            share["virtual"][i, j, k] += bool(found.virtual_points_px)
            share["pose"][i, j, k] += detection.pose is not None
            for n, name in enumerate(ELEMENT_NAMES):
                position = found.blobs_px.get(name)
                if position is not None:
                    blob[i, j, k, n] += 1
                    off[n].append(float((position - truth[name]) @ axis[name] / np.linalg.norm(axis[name])))
            if detection.pose is not None:
                turned.append(np.degrees(chain.pose_errors(here, detection.pose)[0]))
        for n in range(4):
            error[i, j, k, n] = np.sqrt(np.mean(np.square(off[n]))) if off[n] else np.nan
        attitude[i, j, k] = np.median(turned) if turned else np.nan
        if progress is not None:
            progress(count + 1, total, "tilts")
    dims = ("range_m", "pitch_deg", "yaw_deg")
    data: dict[str, Any] = {name: (dims, value / plan.draws, {"units": "1"}) for name, value in share.items()}
    data["blob"] = ((*dims, "element"), blob / plan.draws, {"units": "1"})
    data["blob_px"] = (
        (*dims, "element"),
        error,
        {"units": "pixel", "long_name": "rms error of a blob along its element"},
    )
    data["light"] = ((*dims, "element"), light, _LIGHT)
    data["centroid_m"] = ((*dims, "element"), centroid, _CENTROID)
    data["attitude_deg"] = (dims, attitude, {"units": "deg", "long_name": "median geodesic attitude error"})
    coordinates = {
        "range_m": ("range_m", list(plan.ranges_m), {"units": "m"}),
        "pitch_deg": ("pitch_deg", grid, {"units": "deg"}),
        "yaw_deg": ("yaw_deg", grid, {"units": "deg"}),
        "element": list(ELEMENT_NAMES),
    }
    return xr.Dataset(data, coordinates, {"draws": plan.draws})


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
        rate = chain.electron_rate(here, basis, "eclipse")
        budget = chain.link_budget(here, "eclipse")
        seconds = chain.solve_exposure(here, budget, "auto")
        view = chain.view(here)
        for n, element in enumerate(here.marker.elements):
            light[k, n], centroid[k, n] = _light_and_centroid(rate, view, element, budget.tape_rate)
        for trial in range(plan.draws):
            blobs = chain.detect(here, chain.expose(here, rate, "eclipse", seconds, trial).dn).features.blobs_px
            seen[k] += [blobs.get(name) is not None for name in ELEMENT_NAMES]
        if progress is not None:
            progress(k + 1, len(yaw), "cut")
    dims = ("yaw_deg", "element")
    data = {
        "light": (dims, light, _LIGHT),
        "centroid_m": (dims, centroid, _CENTROID),
        "found": (
            dims,
            seen / plan.draws,
            {"units": "1", "long_name": "share of noisy frames in which the blob is found"},
        ),
    }
    return xr.Dataset(data, {"yaw_deg": ("yaw_deg", yaw, {"units": "deg"}), "element": list(ELEMENT_NAMES)})


#: A neighbourhood of the opening from which its blurred light is taken: point spread and pixel [px].
_SPILL_PX = 1.5


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


def run(scenario: Scenario, quick: bool = False, progress: Progress | None = None) -> xr.DataTree:
    """Map and cut, groups 'map' and 'cut'."""
    plan = QUICK if quick else FULL
    tree = xr.DataTree.from_dict({"map": map_of(scenario, plan, progress), "cut": cut_of(scenario, plan, progress)})
    tree.attrs |= chain.provenance(scenario)
    return tree
