"""Figures of the field of view: maps over pitch × yaw, and an element's light along its cut."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from detector.elements.slits import Slits
from experiments.reporting.figures import BLACK, BLUE, GREEN, ORANGE, VERMILION, new_figure
from experiments.thesis.fov import closed_form
from radiometry import field_of_view as fov
from radiometry.geometry import attitude_matrix
from scenes.marker import ELEMENT_NAMES, MarkerDesign

CAPTIONS = {
    "marker": "What the detector finds over pitch and yaw: blobs, share of frames with a virtual point, attitude error. The "
    "lines show where a virtual point is seen by equations 5.18 to 5.20 as printed, by the same with half the lateral field, "
    "and by the closed form here.",
    "element": "The top element alone: light of its blob over that on the axis, and share of noisy frames that have the blob.",
    "cut": "One element along and across: light of the blob, error of a plain centroid, and where the detector finds it.",
}
_FINE_DEG = np.linspace(-79, 79, 159)


def _fine() -> tuple[np.ndarray, np.ndarray]:
    """Pitch and yaw [rad] of a fine grid, first index pitch."""
    return np.meshgrid(np.radians(_FINE_DEG), np.radians(_FINE_DEG), indexing="ij")


def virtual_point(found: closed_form.Limits, model: str) -> np.ndarray:
    """Where a virtual point exists on the fine grid: one element of each direction; 'here', 'printed' or 'half'."""
    pitch, yaw = _fine()
    if model == "here":
        masks = {name: closed_form.seen(found, name, pitch, yaw) for name in ELEMENT_NAMES}
    else:
        printed = model == "printed"
        masks = {name: closed_form.in_ellipse(found, name, pitch, yaw, printed) for name in ELEMENT_NAMES}
    return (masks["top"] | masks["bottom"]) & (masks["right"] | masks["left"])


def _contours(axis: Any, lines: dict[str, tuple[np.ndarray, str, str]]) -> list[Any]:
    handles = []
    for label, (mask, colour, style) in lines.items():
        axis.contour(
            _FINE_DEG, _FINE_DEG, mask.astype(float), levels=[0.5], colors=[colour], linestyles=[style], linewidths=1.4
        )
        handles += axis.plot([], [], color=colour, ls=style, label=label)
    return handles


def _map(
    figure: Figure, axis: Any, values: xr.DataArray, label: str, span: tuple[float, float], colours: str = "Greys_r"
) -> None:
    step = float(values.yaw_deg[1] - values.yaw_deg[0]) / 2
    reach = [float(v) for v in (values.yaw_deg[0] - step, values.yaw_deg[-1] + step)]
    image = axis.imshow(
        values.transpose("pitch_deg", "yaw_deg"),
        vmin=span[0],
        vmax=span[1],
        cmap=colours,
        origin="lower",
        interpolation="nearest",
        extent=(*reach, *reach),
    )
    figure.colorbar(image, ax=axis, label=label, shrink=0.85)
    axis.set(xlabel="yaw [deg]", ylabel="pitch [deg]", aspect="equal", xlim=(-78, 78), ylim=(-78, 78))
    axis.grid(visible=False)


def _requirement(axis: Any) -> list[Any]:
    """Directions 45° off the normal: cos(pitch) cos(yaw) = cos 45°."""
    pitch, yaw = _fine()
    tilt = np.degrees(np.arccos(np.cos(pitch) * np.cos(yaw)))
    axis.contour(_FINE_DEG, _FINE_DEG, tilt, levels=[45.0], colors=[BLACK], linestyles=":", linewidths=1.2)
    return list(axis.plot([], [], color=BLACK, ls=":", label="45° off the normal"))


def marker_maps(data: xr.Dataset, marker: MarkerDesign) -> Figure:
    """Virtual point shown and found, and attitude error, over pitch × yaw; one row a range."""
    found = closed_form.limits(marker)
    lines = {
        "virtual point, eq. 5.20 as printed": (virtual_point(found, "printed"), VERMILION, "--"),
        "eq. 5.20, half the lateral field": (virtual_point(found, "half"), ORANGE, "-."),
        "closed form here": (virtual_point(found, "here"), BLUE, "-"),
    }
    rows = data.sizes["range_m"]
    figure, axes = new_figure(rows, 3, (10.0, 0.7 + 2.9 * rows))
    handles: list[Any] = []
    for row, range_m in zip(axes, data.range_m.values, strict=True):
        at = data.sel(range_m=range_m)
        _map(figure, row[0], at.blob.sum("element"), f"blobs found, {range_m:g} m", (0, 4))
        _map(figure, row[1], at.virtual, f"frames with a virtual point, {range_m:g} m", (0, 1))
        error = np.log10(at.attitude_deg.where(at.attitude_deg > 0))
        _map(figure, row[2], error, f"log10 attitude error [deg], {range_m:g} m", (-2, 1), "viridis")
        for axis in row:
            handles = _contours(axis, lines) + _requirement(axis)
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8)
    return figure


def on_axis(data: xr.Dataset) -> float:
    """Largest light of an element seen squarely."""
    return float(data.light.sel(pitch_deg=0.0, yaw_deg=0.0, method="nearest").max())


def element_map(data: xr.Dataset, marker: MarkerDesign) -> Figure:
    """Light of the top element and share of frames in which its blob is found, at the first range."""
    found = closed_form.limits(marker)
    pitch, yaw = _fine()
    lines = {
        "eq. 5.20 as printed": (closed_form.in_ellipse(found, "top", pitch, yaw, True), VERMILION, "--"),
        "half the lateral field": (closed_form.in_ellipse(found, "top", pitch, yaw, False), ORANGE, "-."),
        "rectangle in slopes": (closed_form.seen(found, "top", pitch, yaw), BLUE, "-"),
    }
    figure, axes = new_figure(1, 2, (9.0, 4.3))
    range_m = float(data.range_m[0])
    at = data.sel(element="top", range_m=range_m)
    # Beyond, the opening is but pixels wide in the image, and what falls into it is its neighbours' light.
    light = (at.light / on_axis(data)).where(abs(at.pitch_deg) < 70)
    _map(figure, axes[0, 0], light, f"light over that on the axis, {range_m:g} m", (0, 1))
    _map(figure, axes[0, 1], at.blob, f"frames with the top blob, {range_m:g} m", (0, 1))
    for axis in axes[0]:
        handles = _contours(axis, lines)
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    return figure


def expected_light(
    marker: MarkerDesign, range_m: float, light_ring_m: float, yaw_deg: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the opening that shows lit floor, by the slit model: top element (along) and right element (across)."""
    along, across = np.zeros(len(yaw_deg)), np.zeros(len(yaw_deg))
    for k, angle in enumerate(yaw_deg):
        rotation = attitude_matrix(0.0, float(np.radians(angle)))
        camera_m = -rotation.T @ np.array([0.0, 0.0, range_m])
        for element, table in ((marker.elements[0], along), (marker.elements[1], across)):
            slits = Slits(marker, element, camera_m, light_ring_m)
            blob = element.blob_offset_m(camera_m)
            end = slits.start + slits.count * slits.pitch
            length = float(slits.seen_up_to(np.array([end]), np.array([blob]))[0, 0])
            slope = (camera_m - element.centre_m) @ element.across / camera_m[2]
            side = float(fov.lateral_share(slope, element.width_m, element.depth_m))
            table[k] = length / element.length_m * side
    return along, across


def cut(data: xr.Dataset, marker: MarkerDesign, range_m: float, light_ring_m: float) -> Figure:
    """Light of top and right element over yaw beside the slit model; centroid error; where the blob is found."""
    found = closed_form.limits(marker)
    yaw = data.yaw_deg.values
    along, across = expected_light(marker, range_m, light_ring_m, yaw)
    figure, axes = new_figure(2, 2, (8.6, 5.6), sharex=True)
    for column, (name, model, title) in enumerate(
        (("top", along, "along the element (top)"), ("right", across, "across the element (right)"))
    ):
        at = data.sel(element=name)
        upper, lower = axes[0, column], axes[1, column]
        upper.plot(yaw, 100 * at.light, ".", color=BLACK, ms=3, label="rendered")
        upper.plot(yaw, 100 * model, color=BLUE, label="slit model")
        style = {"color": GREEN, "alpha": 0.15, "lw": 0, "transform": upper.get_xaxis_transform()}
        upper.fill_between(yaw, 0, 1, where=at.found > 0.5, label="blob found", **style)
        lower.plot(yaw, 1e3 * at.centroid_m, ".", color=BLACK, ms=3)
        if name == "top":
            limits = [(-found.thesis.near, -found.found.near), (found.thesis.far, found.found.far)]
        else:
            half = closed_form.THESIS_LATERAL_RAD / 2
            limits = [(-half, -found.lateral), (half, found.lateral)]
        for printed, here in limits:
            for axis in (upper, lower):
                axis.axvline(np.degrees(printed), color=VERMILION, ls="--", lw=1)
                axis.axvline(np.degrees(here), color=BLUE, ls="-", lw=1)
        upper.set(title=title, ylabel="light over a floor of tape [%]", ylim=(0, None))
        lower.set(xlabel="yaw [deg]", ylabel="error of a plain centroid [mm]", ylim=(-3, 3))
    handles, _ = axes[0, 0].get_legend_handles_labels()
    handles += axes[0, 0].plot([], [], color=VERMILION, ls="--", lw=1, label="thesis's limit")
    handles += axes[0, 0].plot([], [], color=BLUE, lw=1, label="limit by closed form")
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8)
    return figure
