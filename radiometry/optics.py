"""Camera optics: projection with distortion, point spread, fall-off, and radiance to electron rate."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy import constants
from scipy.special import ndtr

from radiometry.distortion import BrownConrady, distort_everywhere, max_ideal_radius
from radiometry.geometry import FloatArray
from radiometry.parameters import Fraction, Positive
from radiometry.spectrum import Spectrum

Coefficient = Annotated[float, Field(ge=-100, le=100, allow_inf_nan=False)]

#: Widest point spread that is imaged [px].
MAX_SIGMA_PX = 20.0


class Camera(BaseModel):
    """Lens and pixel grid of a monochrome camera. Pixel centres lie at integer coordinates.

    Raises:
        ValueError: when the stray-light table does not increase within its bounds, or the distortion folds the image back
            within the frame.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width_px: int = Field(752, ge=16, le=16384, description="columns of the detector")
    height_px: int = Field(580, ge=16, le=16384, description="rows of the detector")
    # Upper bounds beyond any lens and pixel, below what figures in millimetres and micrometres come to.
    pixel_pitch_x_m: Positive = Field(8.6e-6, le=1e-3, description="column pitch [m]")
    pixel_pitch_y_m: Positive = Field(8.3e-6, le=1e-3, description="row pitch [m]")
    focal_length_m: Positive = Field(20.19e-3, le=10, description="focal length [m]")
    f_number: Positive = Field(2.8, description="focal length over entrance pupil diameter")
    lens_transmission: Fraction = Field(0.35, description="throughput of lens and filter holder, without the filter")
    psf_sigma_px: float = Field(
        0.5,
        ge=0,
        le=MAX_SIGMA_PX,
        description="standard deviation of the lens's Gaussian point spread in focus, before the pixel; never below diffraction, "
        "but 0 is an ideal lens without either [px]",
    )
    focus_m: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        None, description="distance of sharp focus [m]; absent: sharp at every range"
    )
    k1: Coefficient = Field(0.0, description="radial distortion r² (Brown–Conrady, as OpenCV's) [-]")
    k2: Coefficient = Field(0.0, description="radial distortion r⁴ [-]")
    p1: Coefficient = Field(0.0, description="tangential distortion, mainly along y [-]")
    p2: Coefficient = Field(0.0, description="tangential distortion, mainly along x [-]")
    k3: Coefficient = Field(0.0, description="radial distortion r⁶ [-]")
    vignetting: Fraction = Field(
        0.0,
        description="light lost at the detector's corner beyond natural fall-off; grows with the square of the image radius",
    )
    veiling_glare: Fraction = Field(
        0.0, description="fraction of the frame's light that the lens scatters evenly over the frame"
    )
    point_source_transmittance: tuple[tuple[float, float], ...] = Field(
        (),
        description="stray light of a Sun outside the field: rows of angle from the axis [deg] and detector irradiance over the "
        "Sun's, lens included, filter not; log-linear between rows, the first one's nearer in, none beyond the last",
    )

    @model_validator(mode="after")
    def _stray_light_table(self) -> Camera:
        table = np.array(self.point_source_transmittance, float)
        if len(table) and not (
            len(table) >= 2
            and np.all(np.diff(table[:, 0]) > 0)
            and 0 <= table[0, 0] <= table[-1, 0] <= 180
            and np.all((table[:, 1] > 0) & (table[:, 1] <= 1))
        ):
            raise ValueError(
                f"point_source_transmittance: {table.tolist()}, expected two or more rows [angle, transmittance] with angles "
                "that increase within 0-180 deg and transmittances above 0 and up to 1"
            )
        return self

    @model_validator(mode="after")
    def _one_to_one(self) -> Camera:
        if self.distorted:
            self._reach_tangent()
        return self

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

    @property
    def distortion(self) -> BrownConrady:
        """The lens's distortion in tangents of the field angle."""
        return BrownConrady(self.k1, self.k2, self.p1, self.p2, self.k3)

    @property
    def distorted(self) -> bool:
        """True where any coefficient of distortion differs from zero."""
        return any((self.k1, self.k2, self.p1, self.p2, self.k3))

    @property
    def without_distortion(self) -> Camera:
        """The same camera with an ideal lens; the camera itself where its lens is ideal."""
        return self.model_copy(update=dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0)) if self.distorted else self

    def project(self, points_camera_m: ArrayLike) -> FloatArray:
        """Image positions of points in the camera frame: pinhole projection, then distortion.

        Far outside the frame Brown–Conrady polynomials turn back. There the distortion goes on in a straight line as at the
        frame's corner.

        Args:
            points_camera_m: (..., 3) [m].

        Returns:
            (..., 2) as column and row [px].

        Example:
            A point on the optical axis is imaged at the centre of the detector:

            >>> from radiometry.optics import Camera
            >>> Camera(width_px=640, height_px=480).project([0.0, 0.0, 5.0]).tolist()
            [319.5, 239.5]
        """
        points = np.asarray(points_camera_m, float)
        tangents = points[..., :2] / points[..., 2:]
        if self.distorted:
            tangents = np.stack(
                distort_everywhere(self.distortion, tangents[..., 0], tangents[..., 1], self._reach_tangent()), axis=-1
            )
        return tangents * self.focal_px + self.principal_point_px

    def undistort_px(self, image_px: ArrayLike) -> FloatArray:
        """Where an ideal lens would image what this lens images at given positions; good to 1e-6 px within the frame.

        Args:
            image_px: positions as column and row, (..., 2) [px].

        Returns:
            (..., 2) [px].
        """
        image = np.asarray(image_px, float)
        if not self.distorted:
            return image
        tangents = (image - self.principal_point_px) / self.focal_px
        with np.errstate(all="ignore"):  # far outside the frame there may be no such place
            ideal = np.stack(self.distortion.undistort(tangents[..., 0], tangents[..., 1]), axis=-1)
        return ideal * self.focal_px + self.principal_point_px

    def natural_falloff(self) -> FloatArray:
        """cos⁴ of the field angle at every pixel, (height, width) [-]. The angle is the one before the lens."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        x = (np.arange(self.width_px) - cx) / fx
        y = (np.arange(self.height_px) - cy) / fy
        if not self.distorted:
            return (1.0 + x**2 + y[:, None] ** 2) ** -2
        x, y = self.distortion.undistort(*np.meshgrid(x, y))
        return (1.0 + x**2 + y**2) ** -2

    def relative_illumination(self) -> FloatArray:
        """Light of a uniform scene at every pixel relative to the optical axis, (height, width) [-].

        It is the product of three factors: cos⁴ of the field angle; the area of the scene that distortion gathers in a
        pixel, because distortion only spreads differently what passes the entrance pupil; and the vignetting 1 − v r²/r_c²,
        with v the loss at the corner pixels and r_c their radius.
        """
        light = self.natural_falloff()
        if not self.distorted and self.vignetting == 0:
            return light
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        x, y = np.meshgrid((np.arange(self.width_px) - cx) / fx, (np.arange(self.height_px) - cy) / fy)
        if self.distorted:
            xx, xy, yy = self.distortion.derivative(*self.distortion.undistort(x, y))
            light = light / (xx * yy - xy**2)
        if self.vignetting > 0:
            light = light * (1 - self.vignetting * (x**2 + y**2) / ((cx / fx) ** 2 + (cy / fy) ** 2))
        return light

    def _reach_tangent(self) -> float:
        """Ideal radius that the frame shows, with the rim from which the point spread gathers light [tangent]."""
        rim_px = 4 * self.psf_sigma_px + 2
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        return max_ideal_radius(self.distortion, (cx + rim_px) / fx, (cy + rim_px) / fy)


def diffraction_sigma_px(camera: Camera, wavelength_nm: float) -> float:
    """Standard deviation of the Gaussian that comes nearest to the core of the Airy pattern [px]: 0.42 λ F#.

    Among the Gaussians with the peak of the pattern (2 J₁(x)/x)², the least-squares fit within the first dark ring has
    0.4206 λ F# (pattern: Born and Wolf, Principles of Optics, 8.5.2). The rings hold 16 % of the light and are left to
    `veiling_glare`. On a detector of unequal pitches, a pixel is the geometric mean of both.

    Args:
        camera: for its F-number and pixel pitches.
        wavelength_nm: of the light [nm].
    """
    return 0.42 * wavelength_nm * 1e-9 * camera.f_number / float(np.sqrt(camera.pixel_area_m2))


def blur_sigma_px(camera: Camera, range_m: float, wavelength_nm: float) -> float:
    """Standard deviation of the lens's Gaussian point spread at a range [px]: √(max(in focus, diffraction)² + defocus²).

    Out of focus, the thin lens images a point as a disc of diameter f²/F# · |1/focus − 1/R| (geometrical optics, for
    distances much longer than the focal length). The root mean square of the disc along each axis is a quarter of that, and
    the Gaussian takes it over.

    Args:
        camera: the lens as specified, in focus at `focus_m`.
        range_m: distance R of the target [m].
        wavelength_nm: of the light [nm].
    """
    diffraction = diffraction_sigma_px(camera, wavelength_nm) if camera.psf_sigma_px > 0 else 0.0
    sigma = max(camera.psf_sigma_px, diffraction)
    if camera.focus_m is None:
        return sigma
    circle_m = camera.focal_length_m**2 / camera.f_number * abs(1 / camera.focus_m - 1 / range_m)
    return float(np.hypot(sigma, circle_m / 4 / np.sqrt(camera.pixel_area_m2)))


def camera_at(camera: Camera, range_m: float, wavelength_nm: float) -> Camera:
    """The camera as it images a range: its `psf_sigma_px` is the whole blur there, and it is in focus at every range.

    Args:
        camera: the lens as specified.
        range_m: distance of the target [m].
        wavelength_nm: of the light [nm].

    Raises:
        ValueError: when the blur exceeds 20 px, or when the point spread gathers light from where the distortion folds
            back.
    """
    sigma = blur_sigma_px(camera, range_m, wavelength_nm)
    if sigma == camera.psf_sigma_px and camera.focus_m is None:
        return camera
    if sigma > MAX_SIGMA_PX:
        focus = "everywhere" if camera.focus_m is None else f"{camera.focus_m:g} m"
        raise ValueError(
            f"focus_m: focus {focus} at F/{camera.f_number:g} blurs a point at {range_m:g} m with a standard deviation of "
            f"{sigma:.1f} px; expected at most {MAX_SIGMA_PX:g} px"
        )
    blurred = camera.model_copy(update={"psf_sigma_px": sigma, "focus_m": None})
    if camera.distorted:
        blurred._reach_tangent()
    return blurred


def electrons_per_joule(wavelength_nm: ArrayLike) -> FloatArray:
    """Photons in one joule of light, λ/(hc) [J⁻¹]: the electrons that it frees at a quantum efficiency of one.

    Args:
        wavelength_nm: any shape [nm].

    Example:
        >>> from radiometry.optics import electrons_per_joule
        >>> f"{electrons_per_joule(850.0):.3e}"
        '4.279e+18'
    """
    return np.asarray(wavelength_nm, float) * 1e-9 / (constants.h * constants.c)


def etendue_m2_sr(camera: Camera) -> float:
    """Area times solid angle of one pixel on the axis [m² sr]: A_pix · π/(4F²), the camera equation with focus at infinity.

    Args:
        camera: for its pixel pitches and F-number.
    """
    return camera.pixel_area_m2 * np.pi / (4 * camera.f_number**2)


def electron_responsivity(camera: Camera, transmission: Spectrum, quantum_efficiency: Spectrum) -> Spectrum:
    """Electron rate per spectral radiance on the axis [e⁻ s⁻¹ / (W m⁻² sr⁻¹ nm⁻¹) nm⁻¹], sampled every 0.5 nm or finer.

    A_pix · π/(4F²) · T_lens · T_filter(λ) · QE(λ) · λ/(hc). The integral of its product with L(λ) is the electron rate of a
    pixel.

    Args:
        camera: for étendue and transmission of the lens.
        transmission: of the filter [-].
        quantum_efficiency: of the sensor [-].
    """
    band = (transmission * quantum_efficiency).resampled(0.5)
    rate = etendue_m2_sr(camera) * camera.lens_transmission * electrons_per_joule(band.wavelength_nm)
    return Spectrum(band.wavelength_nm, band.values * rate)


def wavelength_nodes(transmission: Spectrum, count: int = 4) -> tuple[int, ...]:
    """Wavelengths at which transport is rendered: Gauss–Legendre nodes of the passband, rounded to whole nanometres.

    Args:
        transmission: filter curve; its support is the passband.
        count: number of nodes, a multiple of four because the renderer carries four wavelengths per ray.

    Returns:
        (count,) increasing [nm].

    Raises:
        ValueError: when the count is not a multiple of four, or the band is too narrow to hold distinct nodes.

    Example:
        >>> from radiometry.filters import Bandpass
        >>> from radiometry.optics import wavelength_nodes
        >>> wavelength_nodes(Bandpass(low_nm=800.0, high_nm=900.0).spectrum())
        (807, 833, 867, 893)
    """
    if count < 4 or count % 4:
        raise ValueError(f"wavelength nodes: {count}, expected a multiple of 4")
    low, high = transmission.support_nm
    nodes = tuple(
        int(n) for n in np.rint((low + high) / 2 + (high - low) / 2 * np.polynomial.legendre.leggauss(count)[0])
    )
    if len(set(nodes)) < count:
        raise ValueError(f"passband {low:g}-{high:g} nm is too narrow for {count} nodes of whole nanometres")
    return nodes


def node_weights(spectral_weight: Spectrum, nodes_nm: ArrayLike) -> FloatArray:
    """Weights w_k such that Σ w_k T(λ_k) = ∫ w(λ) T(λ) dλ for every transport T that is a cubic through the nodes.

    The weights integrate the Lagrange polynomials of the nodes against w(λ). Line emitters and filter edges are therefore
    resolved by the grid of w, not by the nodes. Interpolation at each λ uses the four nodes nearest to it.

    Args:
        spectral_weight: w(λ), for example emitter times responsivity.
        nodes_nm: increasing wavelengths, (n,) with n ≥ 4 [nm].

    Returns:
        (n,) in the unit of w times nm.
    """
    nodes = np.asarray(nodes_nm, float)
    wavelength, value = spectral_weight.wavelength_nm, spectral_weight.values
    step = np.diff(wavelength)
    trapezoid = np.concatenate([[step[0]], step[:-1] + step[1:], [step[-1]]]) / 2
    first = np.clip(np.searchsorted(nodes, wavelength) - 2, 0, len(nodes) - 4)
    weights = np.zeros(len(nodes))
    for j in range(4):
        basis = np.ones_like(wavelength)
        for m in range(4):
            if m != j:
                basis *= (wavelength - nodes[first + m]) / (nodes[first + j] - nodes[first + m])
        np.add.at(weights, first + j, trapezoid * value * basis)
    return weights


def pixel_profile_integral(x_px: ArrayLike, psf_sigma_px: float) -> FloatArray:
    """Response of a pixel at 0 to a half plane that is bright at positions below x, between 0 and 1.

    It is the cumulative of a unit box (the pixel) convolved with a Gaussian (the point spread), in closed form.

    Args:
        x_px: position of the edge, any shape [px].
        psf_sigma_px: standard deviation of the point spread [px].
    """
    sigma = max(psf_sigma_px, 1e-6)

    def ramp(t: FloatArray) -> FloatArray:  # twice integrated Gaussian density
        z = t / sigma
        return sigma * (z * ndtr(z) + np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))

    x = np.asarray(x_px, float)
    return ramp(x + 0.5) - ramp(x - 0.5)
