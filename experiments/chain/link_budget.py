"""The closed-form budget of one range and illumination, and the exposure that follows from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from detector.sensor.sensor import Sensor, usable_well_electrons
from experiments.chain.illumination import active_sources, sun_stray_rate
from experiments.scenario import Scenario
from materials import library
from radiometry import link, stray
from radiometry.earth import earth_transport
from radiometry.geometry import FloatArray
from radiometry.spectrum import Spectrum
from scenes.projection.bits import bit_pixels, bit_scale_px
from scenes.projection.frame_light import mean_frame_rate
from scenes.projection.visible import hidden_face, visible_tape
from scenes.view import View


@dataclass(frozen=True)
class LinkBudget:
    """Closed-form budget of one range and illumination.

    Attributes:
        signal_rate, background_rate: electrons per second of a bright bit's and of a neighbouring dark cell's pixels.
        tape_rate: of tape that fills its pixels, without point spread and neighbours.
        px_per_bit: pixels along the shorter side of a bit.
        smear_px_per_s: motion of the target across the image.
        fill: share of a bright bit's light that comes from reflective cells.
    """

    sensor: Sensor
    signal_rate: float
    background_rate: float
    tape_rate: float
    px_per_bit: float
    smear_px_per_s: float
    fill: float

    def at(self, exposure_s: float) -> dict[str, float]:
        """Signal, background and dark charge [electrons], SNR, CNR, full-well fraction and smear [px] of one exposure."""
        signal, background = self.signal_rate * exposure_s, self.background_rate * exposure_s
        dark = self.sensor.dark_electrons(exposure_s)
        noise, noise_of_dark = (self._noise_electrons(level) for level in (signal, background))
        both = float(np.sqrt((noise**2 + noise_of_dark**2) / 2))  # `link.cnr` takes one noise for either pixel
        return {
            "signal": signal,
            "background": background,
            "dark": dark,
            "snr": float(link.snr(signal, dark, noise)),
            "cnr": float(link.cnr(signal, background, dark, both)),
            "full_well_fraction": (signal + dark) / usable_well_electrons(self.sensor),
            "smear_px": self.smear_px_per_s * exposure_s,
        }

    def _noise_electrons(self, level: float) -> float:
        """Noise beside shot noise of a pixel at a level [electrons]: read noise, quantisation, and non-uniformity."""
        sensor = self.sensor
        return float(np.sqrt(sensor.total_noise_electrons**2 + sensor.dsnu_electrons**2 + (sensor.prnu * level) ** 2))


@dataclass(frozen=True)
class Bits:
    """Some bits of a marker: their centres on the marker's plane (n, 3) [m], and the pixels (rows, columns) that see each."""

    centres_m: FloatArray
    pixels: list[tuple[NDArray[np.intp], NDArray[np.intp]]]

    @classmethod
    def of(cls, view: View, centres_m: FloatArray) -> Bits:
        """The bits of given centres in a view."""
        return cls(centres_m, bit_pixels(view, centres_m))

    @property
    def index(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of all pixels."""
        return np.concatenate([rows for rows, _ in self.pixels]), np.concatenate(
            [columns for _, columns in self.pixels]
        )

    def mean(self, image: FloatArray) -> float:
        """Mean over bits of the mean over each bit's pixels; NaN where none is in the frame."""
        seen = [image[places].mean() for places in self.pixels if len(places[0])]
        return float(np.mean(seen)) if seen else np.nan


@dataclass(frozen=True)
class FaceRates:
    """Electron rates of points on the target's face in closed form, by material and source.

    Attributes:
        view: where the face is seen from.
        response: electron rate per spectral radiance of camera, filter and sensor.
        spectra: spectral strength of each source, by its name.
    """

    view: View
    response: Spectrum
    spectra: Mapping[str, Spectrum]

    @cached_property
    def _wavelength_nm(self) -> FloatArray:
        return link.band_grid(self.response)

    @cached_property
    def _viewer_m(self) -> FloatArray:
        return self.view.to_marker(np.zeros(3))

    @cached_property
    def _leds_m(self) -> FloatArray:
        return self.view.to_marker(self.view.leds.positions_m())

    @cached_property
    def _falloff(self) -> FloatArray:
        return self.view.camera.relative_illumination()

    def rate(self, points_m: FloatArray, material: str, sources: Iterable[str]) -> FloatArray:
        """Electrons per second (n,) of pixels that see points (n, 3) of a material, by the light of some sources."""
        brdf, total = library.load(material).brdf, np.zeros(len(points_m))
        for source in sources:
            transport = self._transport(points_m, brdf, source)
            total += link.electron_rate(transport, self._wavelength_nm, self.spectra[source], self.response)
        column, row = np.rint(self.view.to_image(points_m)).astype(int).T
        height, width = self._falloff.shape
        return total * self._falloff[row.clip(0, height - 1), column.clip(0, width - 1)]

    def _transport(self, points_m: FloatArray, brdf: link.Brdf, source: str) -> FloatArray:
        """Radiance per unit source strength, by point and wavelength."""
        view = self.view
        if source == "sun":
            return link.sun_transport(points_m, self._viewer_m, view.sun_in_marker, brdf, self._wavelength_nm)
        if source == "led":
            return link.ring_transport(
                points_m,
                self._viewer_m,
                self._leds_m,
                axis=view.rotation[2],
                ring=view.leds,
                brdf=brdf,
                wavelength_nm=self._wavelength_nm,
            )
        # The Earth's disc is so far, and so wide, that the marker's centre stands for all points.
        assert view.earth is not None
        towards, radius = view.earth_in_marker, view.earth.angular_radius_rad
        out = self._viewer_m / np.linalg.norm(self._viewer_m)
        return earth_transport(out, towards, radius, brdf, self._wavelength_nm)

    def bit_level(self, bits: Bits, sources: Sequence[str]) -> tuple[float, float]:
        """Mean electron rate of some bits' pixels, and the share of their light that comes from tape; NaN where none is seen."""
        target = self.view.target
        seen = np.array([len(rows) > 0 for rows, _ in bits.pixels])
        if not seen.any():
            return np.nan, np.nan
        polygons, shares = self._visible_tape
        fill, centres = self._share(bits, polygons, shares), bits.centres_m[seen]
        level = fill * self.rate(centres, target.tape_material, sources)
        for source in sources:
            hidden = self._share(bits, self._hidden_face["sun" if source == "sun" else "led"][None], np.ones(1))
            level += (hidden - fill) * self.rate(centres, target.absorber_material, (source,))
            level += (1 - hidden) * self.rate(centres, target.face_material, (source,))
        return float(np.mean(level)), float(np.mean(fill))

    @cached_property
    def _visible_tape(self) -> tuple[FloatArray, FloatArray]:
        return visible_tape(self.view)

    @cached_property
    def _hidden_face(self) -> dict[str, FloatArray]:
        return hidden_face(self.view)

    def _share(self, bits: Bits, polygons_px: FloatArray, shares: FloatArray) -> FloatArray:
        """Mean over each seen bit's pixels of the share of their light that comes from inside polygons."""
        pixels = [np.column_stack(places[::-1]) for places in bits.pixels]
        ends = np.cumsum([len(places) for places in pixels])[:-1]
        share = link.reflective_fill(np.concatenate(pixels), polygons_px, self.view.camera.psf_sigma_px, shares)
        return np.array([part.mean() for part in np.split(share, ends) if len(part)])


def solve_link_budget(
    scenario: Scenario,
    faces: FaceRates,
    bright: Bits,
    dark: Bits,
    illumination: str,
    *,
    mean_rate: float | None = None,
) -> LinkBudget:
    """The closed-form budget of a scenario in an illumination, from its prepared parts (see `experiments.chain.case.Case`).

    Args:
        scenario: camera, target and sensor.
        faces: electron rates of points on the face.
        bright: the reflective bits.
        dark: the absorbing cells beside them.
        illumination: 'eclipse' or 'sunlit'.
        mean_rate: electrons per second and pixel of the whole imaged frame, without stray light from outside it, for veiling
            glare to spread; absent, the closed form's own estimate (`scenes.projection.frame_light`).
    """
    view, camera, tape = faces.view, scenario.camera, scenario.target.tape_material
    sources = active_sources(scenario, illumination)
    (signal, fill), (background, _) = faces.bit_level(bright, sources), faces.bit_level(dark, sources)
    if camera.veiling_glare > 0:
        if mean_rate is None:
            mean_rate = mean_frame_rate(view, lambda points, material: faces.rate(points, material, sources))
        signal, background = (
            float(stray.add_veiling_glare(v, camera.veiling_glare, mean_rate)) for v in (signal, background)
        )
    if illumination == "sunlit" and camera.point_source_transmittance:
        signal, background = (v + sun_stray_rate(scenario) for v in (signal, background))
    speed_m_s = scenario.target.tumble_speed_m_s
    return LinkBudget(
        sensor=scenario.sensor,
        signal_rate=signal,
        background_rate=background,
        tape_rate=float(np.mean(faces.rate(bright.centres_m, tape, sources))),
        px_per_bit=float(scenario.marker.bit_m * min(bit_scale_px(view))),
        smear_px_per_s=float(link.smear_px(camera, scenario.range_m, speed_m_s, 1.0)),
        fill=fill,
    )


def solve_exposure(scenario: Scenario, budget: LinkBudget, exposure: float | str) -> float:
    """The exposure in seconds; 'auto' is the one that brings the bright bits to the wanted fraction of full well.

    Raises:
        ValueError: for 'auto' where no bit is in the frame.
    """
    if not isinstance(exposure, str):
        return exposure
    auto = scenario.auto_exposure
    charge = auto.full_well_fraction * usable_well_electrons(scenario.sensor)
    rate = budget.signal_rate + scenario.sensor.dark_rate_electrons_per_s
    if np.isnan(rate):
        raise ValueError(
            f"exposure_s: 'auto' needs a bit in the frame, and none is at {scenario.range_m:g} m; shorten "
            "camera.focal_length_m, leave the range out, or give seconds [s]"
        )
    longest = min(auto.longest_s, scenario.leds.longest_pulse_s)
    return float(np.clip(charge / rate if rate > 0 else np.inf, min(auto.shortest_s, longest), longest))
