"""The page of `mantis errata`: the thesis's conclusions beside what is true, and the three models with every step between."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict

from experiments.reporting.blocks import Block, Card, Details, Plot, Plots, Section, Text, text_table
from experiments.reporting.formatting import seconds_text
from experiments.reporting.page import Page
from experiments.thesis.claims import THESIS
from experiments.thesis.errata import figures
from experiments.thesis.errata.facts import Facts, facts
from experiments.thesis.errata.study import ErrataResult
from experiments.thesis.errata.tables import digits, models_table, sources_table, steps_file, steps_table, whole

ABOUT = (
    f"Section 6.2 of the thesis ({THESIS}) computes the signal-to-noise ratio (SNR) of one bit of the marker over range, in "
    "eclipse and in sunlight (listing A.5). This page sets three models of it side by side.",
    "As printed: the listing, errors included (radiometry/thesis.py). Corrected: the thesis's own assumptions, a flat tape of "
    "200 sr⁻¹ and ideal optics, with its errors corrected one at a time (radiometry/corrections.py). Full: this project's "
    "closed form, with the tape's lobe, the ring of LEDs, point spread, neighbours and background "
    "(radiometry/extensions.py, and independently of it experiments/chain/link_budget.py).",
    "All three have the thesis's 100 LEDs behind a beam of 16° (8° for figure 6.4), its bit of 5 mm and its camera. "
    "mantis errata --json prints every number of this page, by topic.",
)
LIMITS = (
    "The reflectance of tape away from its lobe (0.10 sr⁻¹ corrected, from the material in full), the loss of the beam optics "
    "(0.8), the baseline of the LEDs, the full well and the coating of the dark cells are assumptions: the thesis gives none "
    "of them.",
    "Table values of the tape come from standards for road signs and hold for visible light.",
    "Below one pixel a bit the contrast depends on how the pattern falls on the pixels, so the CNR of the full model is not "
    "smooth over range; here the marker stands centred and square.",
    "Foil, Earth light and stray light are left out.",
    "The camera of all three models is the thesis's mixture: geometry of the VBS camera, quantum efficiency and read noise of "
    "the GT4096 NIR.",
)


def page(result: ErrataResult, command: str) -> Page:
    """What the errata study says.

    Args:
        result: of `study.run`.
        command: the command line that makes it again.
    """
    found = facts(result)
    return Page(
        study="errata",
        stem="thesis-errata",
        title="The thesis's link budget: errata",
        headline=(
            f"In eclipse the printed signal is {digits(found.eclipse.corrected_over_printed_8m)} times too small at 8 m. Light "
            f"is not what is missing: saturation fails first, and sampling ends the range at {digits(found.sampling.ends_m)} m."
        ),
        passed=None,
        command=command,
        about=ABOUT,
        cards=tuple(_cards(found)),
        sections=(
            Section("eclipse", "Eclipse", tuple(_eclipse(result, found))),
            Section("sun", "Sunlight", tuple(_sunlight(result, found))),
            Section("limit", "The real limit at 20 m", tuple(_limit(result, found))),
            Section("claims", "Claim by claim", tuple(_claims(found)), wordy=True),
            Section("steps", "From the printed to the full model, step by step", tuple(_steps(result, found))),
            Section("sources", "What each step changes", (sources_table(result),), wordy=True),
            Section("models", "Three models", tuple(_models(result))),
        ),
        limits=LIMITS,
        scenario=result.scenario,
        data=result.dataset,
        extra=asdict(found),
    )


def _cards(found: Facts) -> Iterator[Card]:
    eclipse, sun, sampling, beam = found.eclipse, found.sun, found.sampling, found.beam
    yield Card(
        "Eclipse, 1/30 s",
        f"{digits(eclipse.full_over_well_least)} to {digits(eclipse.full_over_well_most)} full wells",
        "charge of a bright bit; the thesis concludes that light is missing above 8 m",
        (
            f"printed SNR {digits(eclipse.printed_snr_8m)} at 8 m",
            f"half a well takes {seconds_text(eclipse.auto_least_s)} to {seconds_text(eclipse.auto_most_s)}",
        ),
        False,
    )
    yield Card(
        "Sunlight, 1 ms",
        "right by accident",
        f"for the Sun alone; the printed SNR is {digits(sun.printed_snr_8m)} at every range",
        (
            f"corrected signal of the Sun alone: {digits(sun.corrected_alone_over_printed_8m)} of the printed one at 8 m",
            f"with the LEDs on {digits(sun.with_leds_over_well_least)} to {digits(sun.with_leds_over_well_most)} full wells",
        ),
        None,
    )
    yield Card(
        "Sampling, bit of 5 mm",
        f"{digits(sampling.px_per_bit_20m)} px/bit at 20 m",
        f"{sampling.needed_px:g} needed: ends at {digits(sampling.ends_m)} m",
        (
            f"20 m takes a bit of {digits(sampling.bit_for_20m_mm)} mm, or a lens of "
            f"{digits(sampling.focal_for_20m_mm)} mm",
        ),
        False,
    )
    yield Card(
        "Beam",
        f"{whole(beam.printed_16deg_w_sr)} W/sr",
        f"as printed; as bought {digits(beam.as_bought_w_sr)} W/sr",
        (f"{digits(beam.printed_over_electrical)} times the LEDs' electrical power",),
        False,
    )


def _eclipse(result: ErrataResult, found: Facts) -> Iterator[Block]:
    e = found.eclipse
    yield Text(
        (
            f"The thesis concludes that at 1/30 s the budget does not close above 8 m: SNR {digits(e.printed_snr_8m)} at 8 m, "
            f"{digits(e.printed_snr_9m)} at 9 m. But the printed signal is too small, by a factor of "
            f"{digits(e.corrected_over_printed_8m)} where a pixel lies within the bit, and of "
            f"{digits(e.corrected_over_printed_20m)} at 20 m. Corrected, the bit sends {digits(e.corrected_signal_8m)} e⁻ at 8 m "
            f"and {digits(e.corrected_signal_20m)} e⁻ at 20 m in 1/30 s; the full model says {digits(e.full_signal_8m)} and "
            f"{digits(e.full_signal_20m)} e⁻. Light is not what is missing.",
            f"What fails is saturation. The charge is {digits(e.full_over_well_least)} to {digits(e.full_over_well_most)} times "
            "a full well of 20 ke⁻ over the ranges, and at the shortest exposure of figure 6.4 (1/200 s, 8°) still "
            f"{digits(e.fig64_shortest_over_well_least)} times or more. An exposure that follows range, from "
            f"{seconds_text(e.auto_least_s)} to {seconds_text(e.auto_most_s)}, half fills the well. The contrast-to-noise "
            f"ratio (CNR) is then {digits(e.auto_cnr_most)} at best and {digits(e.auto_cnr_least)} at worst, at "
            f"{whole(e.auto_cnr_least_at_m)} m, against the 10 that is asked for. What lowers it there is the blur between "
            "bits smaller than a pixel, not a lack of light. A single one of the hundred LEDs does at 20 m what all of them "
            f"do, in {seconds_text(e.one_led_20m_s)}.",
        )
    )
    caption = "SNR over range in eclipse: printed, corrected and full. Open markers: the pixel overflows."
    yield Plots((Plot("eclipse", figures.eclipse_figure(result), caption),))


def _sunlight(result: ErrataResult, found: Facts) -> Iterator[Block]:
    s = found.sun
    yield Text(
        (
            f"The thesis concludes that in sunlight the budget closes easily at 1 ms, with SNR {digits(s.printed_snr_8m)} at "
            "every range. For the light of the Sun alone that number is right by accident: the listing gives the Sun a retro "
            "peak although the Sun does not stand behind the camera (2000 times too much), and this makes up for the second "
            f"pixel area and the aperture. Corrected, the signal is {digits(s.corrected_alone_over_printed_8m)} times the "
            f"printed one at 8 m and {digits(s.corrected_alone_over_printed_20m)} times at 20 m; in full it is "
            f"{digits(s.full_alone_over_printed_8m)} and {digits(s.full_alone_over_printed_20m)} times.",
            "But the LEDs of the sunlit case are on, too. Lit for 1 ms they are "
            f"{digits(s.leds_over_sun_least)} to {digits(s.leds_over_sun_most)} times brighter on the tape than the Sun. The "
            f"bit then takes {digits(s.with_leds_over_well_least)} to {digits(s.with_leds_over_well_most)} full wells, and the "
            f"printed verdict is wrong. Without the LEDs the well is filled {digits(s.alone_over_well_least)} to "
            f"{digits(s.alone_over_well_most)} times, above the allowed 0.7 at {s.alone_saturates_at}. A pulse of "
            f"{seconds_text(s.auto_least_s)} to {seconds_text(s.auto_most_s)} serves sunlight as it serves eclipse, with a CNR "
            f"of {digits(s.auto_cnr_least)} to {digits(s.auto_cnr_most)}. The glint of foil beside the marker is not in this "
            "closed form; mantis glare is about that.",
        )
    )
    caption = "SNR over range in sunlight at 1 ms, with the LEDs on and without."
    yield Plots((Plot("sun", figures.sunlight_figure(result), caption),))


def _limit(result: ErrataResult, found: Facts) -> Iterator[Block]:
    s = found.sampling
    yield Text(
        (
            "The thesis takes illumination for the limit at 20 m. The limit is sampling: a bit of 5 mm covers "
            f"{digits(s.px_per_bit_20m)} pixels there. Two pixels a bit, the least that tells a bit from its neighbour, are "
            f"reached up to {digits(s.ends_m)} m, and up to {digits(s.ends_10mm_m)} m with a bit of 10 mm. To read the pattern "
            f"at 20 m takes a bit of {digits(s.bit_for_20m_mm)} mm with this lens, or a focal length of "
            f"{digits(s.focal_for_20m_mm)} mm with this bit. No LED, exposure or tape changes that.",
        )
    )
    caption = "Pixels per bit over range, and the margin of each criterion of the full model in eclipse."
    yield Plots((Plot("limit", figures.limit_figure(result), caption),))


def _claims(found: Facts) -> Iterator[Block]:
    rows = [("the thesis concludes", "what is true", "where to look"), *_light_claims(found), *_system_claims(found)]
    yield text_table(rows, "What the thesis concludes, and what is true")
    yield Text(("The trade-off of chapter 4 has a page of its own: mantis tradeoff.",))


def _light_claims(found: Facts) -> list[tuple[str, str, str]]:
    """What the thesis concludes of LEDs, eclipse and sunlight."""
    b, e, s = found.beam, found.eclipse, found.sun
    return [
        (
            "100 LEDs give 40 kW/sr (6.2)",
            f"{whole(b.printed_16deg_w_sr)} W/sr is a half angle of 12° taken for 12 rad. As bought the LEDs give "
            f"{digits(b.as_bought_w_sr)} W/sr; if all their light were narrowed to 16° {digits(b.corrected_16deg_w_sr)} W/sr, "
            f"to 8° {whole(b.corrected_8deg_w_sr)} W/sr.",
            "mantis errata --json, beam",
        ),
        (
            "the same, as power",
            f"It would be {digits(b.printed_power_w)} W of light in the cone from LEDs that draw "
            f"{digits(b.electrical_power_w)} W: {digits(b.printed_over_electrical)} times their electrical power, "
            f"{digits(b.printed_over_emitted)} times their light. Such a ring is refused.",
            "mantis budget --set leds.intensity_w_sr=402.47 --set leds.half_angle_deg=8",
        ),
        (
            "eclipse does not close above 8 m at 1/30 s (6.2), above 6 m (6.4)",
            "By SNR it closes at every range, and it saturates at every range. The two printed ranges imply different limits: "
            f"SNR {digits(e.printed_snr_8m)} to {digits(e.printed_snr_9m)}, and {digits(e.printed_snr_6m)} to "
            f"{digits(e.printed_snr_7m)}.",
            "mantis errata, table of models",
        ),
        (
            "a beam of 8° at 1/50 s closes it to 20 m (figure 6.4)",
            f"The listing gives SNR {digits(e.printed_snr_20m_fig64)} there, below the limit that failed 9 m. In truth it "
            "saturates more.",
            "mantis errata, table of models",
        ),
        (
            "longer exposures help, up to 1/50 s (6.2)",
            f"1/50 to 1/200 s are all shorter than 1/30 s; what is needed is {seconds_text(e.auto_most_s)} and less.",
            "mantis errata --json, eclipse",
        ),
        (
            "sunlight closes easily at 1 ms",
            "Right by accident for the Sun alone, wrong with the LEDs on; see above.",
            "mantis errata --json, sun",
        ),
        (
            "the band holds 100 W/m² of sunlight",
            f"{s.band_w_m2:.1f} W/m², and it is an irradiance, not a radiance.",
            "mantis errata --json, sun",
        ),
        (
            "the curve was validated by its shape over range (6.2)",
            "A shape cannot show a constant factor: from 8 to 20 m the printed and the corrected curve differ by "
            f"×{digits(e.shape_change)}, in size by ×{digits(e.corrected_over_printed_8m)}.",
            "mantis errata --json, eclipse",
        ),
    ]


def _system_claims(found: Facts) -> list[tuple[str, str, str]]:
    """What the thesis concludes of tape, noise, camera and power."""
    n, p, s, t = found.noise, found.power, found.sampling, found.tape
    return [
        (
            "200 sr⁻¹ is conservative",
            f"It is no constant. With LEDs {whole(100 * t.baseline_m)} cm beside the lens, Type XI tape has "
            f"{digits(t.brdf_1m_sr)} sr⁻¹ at 1 m, {digits(t.brdf_8m_sr)} at 8 m and {digits(t.brdf_20m_sr)} at 20 m.",
            "mantis errata --json, tape",
        ),
        (
            "at range and in eclipse retroreflection is required (6.3)",
            f"Not for the light: a white Lambertian bit gives {digits(t.spectralon_signal_20m)} e⁻ at 20 m in 1/30 s, SNR "
            f"{digits(t.spectralon_snr_20m)}. Tape is for contrast with the Sun.",
            "mantis errata --json, tape",
        ),
        (
            "the system is shot-noise limited; 28.2 e⁻ is dark shot noise",
            f"28.2 e⁻ is read noise, and the larger of the two below {digits(n.equal_at_e)} e⁻: in the listing's own eclipse "
            f"at {n.read_noise_dominates_at}. Noises add in variance; that correction alone is worth "
            f"×{digits(n.quadrature_factor_20m)} at 20 m and ×{digits(n.quadrature_factor_most)} at most.",
            "mantis errata --json, noise",
        ),
        (
            "the noise includes reflections of the foil",
            "These lines are commented out. The listing's own ratio of bit to foil is "
            f"{digits(n.listing_bit_over_foil_8m)}, as it does not give both the same irradiance; with its two reflectances "
            f"it is {whole(n.right_bit_over_foil)}.",
            "mantis errata --json, noise",
        ),
        (
            "a field of view of 16°",
            f"752 pixels of 8.6 µm behind 20.19 mm see {digits(s.field_of_view_deg)}°.",
            "mantis errata --json, sampling",
        ),
        (
            "5 W allow 1.2 frames a second at 1/50 s",
            f"{digits(p.printed_fps)}: the arithmetic is right, {digits(p.printed_energy_j)} J a frame. At "
            f"{seconds_text(found.eclipse.auto_most_s)} a frame takes {digits(p.energy_j)} J, and ten a second "
            f"{digits(p.power_10fps_w)} W.",
            "mantis errata --json, power",
        ),
        ("illumination limits the range of 20 m", "Sampling does.", "mantis errata --json, sampling"),
    ]


def _steps(result: ErrataResult, found: Facts) -> Iterator[Block]:
    yield Text(
        (
            "Each factor is the model after the step over the model before it. S is the signal of a bit's pixel, SNR is as the "
            "model then defines it, which from the step ‘background’ on is the CNR. ‘Sun alone’ leaves the LEDs out. An SNR "
            f"beyond {digits(found.full_pixel_snr)}, that of a full pixel, is formal.",
        )
    )
    yield steps_table(result)
    yield Text(
        (
            "The last step and the full model are two computations of the same physics, one on the axis and at 850 nm, the "
            f"other over the marker and the spectra; they agree to {digits(found.agreement_percent)} % or better at every "
            "range.",
        )
    )
    yield Plots(
        (
            Plot(
                "steps-eclipse",
                figures.steps_figure(result, "eclipse", 8.0),
                "Signal and SNR at 8 m in eclipse, from the printed to the full model.",
            ),
        )
    )
    yield Plots(
        (
            Plot(
                "steps-sun",
                figures.steps_figure(result, "sun alone", 8.0),
                "Signal and SNR at 8 m of the Sun alone, from the printed to the full model.",
            ),
        )
    )
    yield Details("Every step in every illumination at 1, 8 and 20 m", (steps_file(result),))


def _models(result: ErrataResult) -> Iterator[Block]:
    yield Text(
        (
            "S in e⁻ as if there were no full well. ‘auto’ is the exposure that half fills the well, within 0.1 µs and "
            "1/30 s, for each model its own; the full model's is given.",
        )
    )
    yield models_table(result)
