"""What the closure page says, a function for each paragraph."""

from __future__ import annotations

from experiments.reporting.formatting import listed, number, percent, ranges_text, seconds_text
from experiments.studies.close.constraints import ConfirmView
from experiments.studies.close.facts import Facts, Sensitive, tape_name
from experiments.studies.close.form import FINE_DIFFERENCE, PHASE_DIFFERENCE
from experiments.studies.close.study import ClosureResult
from experiments.studies.close.tables import closing_ranges, misses


def title(result: ClosureResult) -> str:
    """Title of the page."""
    ranges = result.constraints.ranges_m
    return f"Closure: which parameter sets close {ranges[0]:g} to {ranges[-1]:g} m"


def headline(result: ClosureResult) -> str:
    """One sentence: whether anything closes, and what is recommended."""
    span = f"{result.form.ranges_m[0]:g}–{result.form.ranges_m[-1]:g} m"
    point = result.recommended
    if point is None:
        return f"No set of parameters closes {span} within the constraints."
    confirmed = any(c.label == point.label and c.confirmed for c in result.confirmed)
    word = "confirmed by rendering" if confirmed else "not confirmed by rendering"
    return (
        f"{len(result.found.closing)} of {result.found.tried:,} parameter sets close {span} in eclipse and sunlight; "
        f"recommended, and {word}: {point.label}, {number(1e3 * point.power_w)} mW."
    )


def about(result: ClosureResult) -> tuple[str, ...]:
    """The question, and how it is answered."""
    limits, base = result.constraints, result.base
    largest_cm = 100 * limits.marker_over_face_max * base.target.face_m
    return (
        f"With one marker of at most {number(largest_cm)} cm, what lens, aperture, illuminator and exposure close the budget "
        f"from {limits.ranges_m[0]:g} to {limits.ranges_m[-1]:g} m, in eclipse and with the Sun at every phase from "
        f"{limits.phases_deg[0]:g}° to {limits.phases_deg[-1]:g}°, with materials and LEDs "
        f"{'at the end of the mission' if limits.end_of_life else 'as new'}? The search runs on the closed form. Every proposed "
        "set is then rendered, exposed and detected.",
        "The constraints, and the assumptions behind them, are in experiments/studies/close/default.toml; a file of your own "
        "takes their place, and --set close.KEY=VALUE changes one of them. A margin is the factor by which a criterion is met; "
        "below 1 it fails.",
    )


def answer(result: ClosureResult, facts: Facts) -> str:
    """What is recommended, and what the rendered frames say of it."""
    p, seen = facts.point, facts.seen
    text = (
        f"Yes: {len(result.found.closing)} of {result.found.tried:,} sets close everywhere. Recommended is a marker of "
        f"{number(100 * p.size_m)} cm with {tape_name(p.tape)} tape, a lens of {number(1e3 * p.focal_length_m)} mm at "
        f"F/{number(p.f_number)} and {p.led_count} LEDs. A pulse takes {number(1e3 * p.energy_j)} mJ. At "
        f"{number(facts.frame_rate_hz)} frames/s this is {number(1e3 * p.power_w)} mW, and {number(p.peak_power_w)} W while the "
        "LEDs shine. "
    )
    if seen is not None:
        cases = f"all {seen.cases} cases" if seen.confirmed else f"{seen.closing} of {seen.cases} cases"
        text += (
            f"Rendered, exposed and detected, it closes {cases}: the marker is found in {seen.found} of {seen.frames} frames, "
            f"attitude is within {number(seen.attitude_deg)}° and range within {percent(seen.range_error)} (95th percentile of "
            "the worst case). "
        )
    return text + f"The cheapest set that closes, by tape: {facts.tapes}."


def proposed(result: ClosureResult) -> str:
    """How the proposed sets were chosen."""
    return (
        f"No set is better than one of these in mean power, marker size and focal length at once. There are "
        f"{len(result.found.front)} such sets; of each marker size the table has the one with the largest margin. Smaller "
        "markers need longer lenses, and since the pupil may not outgrow a bit (defocus), darker ones: power rises as the "
        "inverse fourth power of the size. Each set has all the LEDs that are allowed, with the fewest that close in brackets. "
        "More LEDs cost no energy, since the pulse gets shorter, and they outshine Sun and glint."
    )


def binding(result: ClosureResult, facts: Facts) -> tuple[str, ...]:
    """Which criteria bind, and which come next."""
    p, limits = facts.point, result.constraints
    near_m, far_m = limits.ranges_m[0], limits.ranges_m[-1]
    m = p.margins
    return (
        f"What binds: {p.binding[0]} at {number(p.binding[1])} m. At {number(far_m)} m a tilted bit must keep "
        f"{number(result.base.requirement.px_per_bit_min)} pixels (sampling, margin {m['sampling']:.3f}). At {number(near_m)} m "
        f"the marker must fit the frame (frame, {m['frame']:.3f}) and stay sharp (focus, {m['focus']:.3f}).",
        "Sampling and frame bound the product of marker size and focal length from both sides, and focus bounds the pupil. Next "
        f"come saturation ({m['saturation']:.2f}, by choice of the exposure), sunlight ({m['sun']:.2f}) and glint "
        f"({m['glint']:.2f}), which more LEDs relieve; then contrast ({number(m['cnr'])}), smear ({number(m['smear'])}), energy "
        f"({number(m['energy'])}) and power ({number(m['power'])}).",
    )


def schedule(result: ClosureResult, facts: Facts) -> str:
    """LEDs and pulses over range."""
    s, ranges = facts.schedule, result.constraints.ranges_m
    shortest = seconds_text(result.base.auto_exposure.shortest_s)
    fewer = (
        f"Where it would be shorter than {shortest}, at {ranges_text(ranges, s.fewer_m)}, fewer LEDs are on."
        if s.fewer_m
        else f"It stays above the shortest of {shortest}, so no range asks for fewer LEDs."
    )
    return (
        f"All LEDs of the set pulse at every range; the pulse brings the bright bits to "
        f"{number(result.base.auto_exposure.full_well_fraction)} of full well. {fewer} Sun is the allowed phase in which the "
        f"tape is brightest, {number(s.brightest_phase_deg)}°; between it and eclipse the pulse differs by "
        f"×{number(s.sun_factor)} at most."
    )


def exposure_follows(facts: Facts) -> str:
    """Why these exposures cannot simply be programmed."""
    s = facts.schedule
    return (
        f"The exposures of this table are a starting point. New tape and LEDs are ×{number(s.new_factor)} brighter than at the "
        f"end of life: an exposure that was set for the end fills new bits to {number(s.new_full_well)} of full well. The "
        f"exposure must follow the image, over a factor of {number(s.pulse_factor)} between the shortest and the longest pulse "
        "of the table."
    )


def sensitivity(facts: Facts) -> str:
    """Which assumptions move the margin."""
    return (
        f"With an exposure that follows the light, the smallest margin that light decides is {number(facts.follow.margin)}; "
        f"saturation stays where the exposure puts it. {_most(facts.follow)} With exposures that were set beforehand the "
        f"smallest margin of saturation and contrast is {number(facts.fixed.margin)}. {_most(facts.fixed)} Sampling and frame "
        "change with the focal length alone, focus with no assumption."
    )


def _most(of: Sensitive) -> str:
    if of.most is None:
        return "No assumption is uncertain."
    low, high = of.ends
    alone = (
        f"below 1 it is taken by {listed(of.failing)} alone" if of.failing else "no assumption alone takes it below 1"
    )
    return f"It depends most on {of.most.name} ({number(low)} to {number(high)}); {alone}."


def drawing(facts: Facts) -> str:
    """How worlds are drawn."""
    return (
        "All assumptions are drawn at once, each log-uniform between its ends and independent of the others, in "
        f"{facts.likely.draws:,} worlds. Intervals are 95 %."
    )


def probability(facts: Facts) -> str:
    """In how many worlds the recommended set closes."""
    likely, best = facts.likely, facts.likeliest
    text = (
        f"The recommended set closes every range in {percent(likely.following)} of the worlds where the exposure follows the "
        f"light, and in {percent(likely.fixed)} where it was set beforehand; in the others of these saturation fails."
    )
    if best is not likely:
        text += f" The most probable is {best.label}, which closes in {percent(best.following)}."
    return text


def alternatives(facts: Facts) -> tuple[str, ...]:
    """What other sensors, filters and rings do."""
    none = f"Nothing closes with {listed(facts.without)}." if facts.without else "Each of them has sets that close."
    best = (
        f"It is largest with {facts.best.name}, {number(facts.best.light_margin)}, whose recommended set is among those rendered."
        if facts.best.changes
        else "None of the others has a larger one."
    )
    words = (
        "The search is made again around other sensors, filters and rings, one change at a time and then the best of each kind "
        f"together, with the best tape. {none} With the scenario's own hardware the smallest margin that light decides "
        f"(contrast, sunlight, glint, energy, power, smear) is {number(facts.own.light_margin)}. {best}",
    )
    if not facts.roomiest.changes:
        return words
    found = facts.roomiest.found
    return (
        *words,
        "Sampling, frame and focus bind because the far end asks for focal length, and the near end for field and depth of "
        f"focus. More pixels widen what lies between: {facts.roomiest.name} closes with the largest share of its sets, "
        f"{len(found.closing):,} of {found.tried:,}.",
    )


def hardware(result: ClosureResult, facts: Facts) -> tuple[str, ...]:
    """How far the thesis's own hardware goes."""
    base, following = result.base, facts.following
    lens = f"{base.camera.focal_length_m * 1e3:.4g} mm F/{base.camera.f_number:g}"
    text = (
        f"The thesis's own system ({lens}, {number(100 * base.marker.size_m)} cm marker, {base.leds.count} LEDs), at its own "
        f"exposures of 1/30 s in eclipse and 1 ms in sunlight, closes at {closing_ranges(facts.as_exposed)}: it misses "
        f"{misses(facts.as_exposed)}. With pulses that follow the light it closes at {closing_ranges(following)}; sampling ends "
        f"at {following.reach_m:.1f} m with {number(result.constraints.tilt_deg)}° of tilt, and at {facts.frontal_reach_m:.1f} m "
        "without."
    )
    change = smallest_change(result)
    if result.minimal and result.minimal.point:
        change += (
            " The same lens at its F-number does not do: its wider pupil outgrows a bit and blurs the near end. A larger marker "
            "exceeds what the face allows, and finer pixels mean another detector."
        )
    return text, change


def smallest_change(result: ClosureResult) -> str:
    """The smallest change of the thesis's hardware that closes every range."""
    if result.minimal is None:
        return "No single change of the thesis's hardware that was tried closes every range."
    far_m = result.constraints.ranges_m[-1]
    return (
        f"The smallest change of the thesis's hardware that reaches {far_m:g} m, with an exposure that follows the light: "
        f"{result.minimal.name}."
    )


def confirmation(result: ClosureResult) -> str:
    """What was rendered, and when a case closes."""
    confirmed, limits = result.confirmed, result.constraints
    if not confirmed:
        return "Nothing was rendered."
    failing = ""
    for c in confirmed:
        if not c.confirmed:
            more = f", and in {len(c.failing) - 1} more cases" if len(c.failing) > 1 else ""
            failing += f"Not confirmed is {c.label}, which fails {c.failing[0]}{more}. "
    views = listed([_view(view, limits.ranges_m) for view in limits.confirm.views])
    life = "the end of life" if limits.end_of_life else "the beginning of life"
    return (
        f"{sum(c.confirmed for c in confirmed)} of {len(confirmed)} sets are confirmed. {failing}The smallest change of the "
        f"thesis's hardware is among those tried. Each set is rendered at {life} at {views}, in eclipse and in sunlight, with "
        f"{limits.confirm.trials} noise draws of each case. The lens is focused at {limits.ranges_m[-1]:g} m. A case closes "
        "where the bits meet saturation and contrast as rendered, every frame shows the marker, and the pose is within the "
        "requirement. The bound on detection is one-sided, at 95 %; draws of a case share pose and pixel phase."
    )


def _view(view: ConfirmView, ranges_m: tuple[float, ...]) -> str:
    return f"{view.label} ({len(view.ranges_m or ranges_m)} ranges)"


def limits(result: ClosureResult) -> tuple[str, ...]:
    """What the search does not say."""
    c = result.constraints
    return (
        "The glint of foil beside the marker is not in the bit criteria. The closed form bounds a facet that mirrors the Sun by "
        f"{number(c.glint_over_well_max)} full wells, an assumption; whether it disturbs detection is for the rendered views and "
        "for mantis glare.",
        f"The search takes the marker frontal and centred, averaged over sub-pixel phases; the tilt of {number(c.tilt_deg)}° "
        "enters sampling alone. From chain.link_budget, at one phase, signal and background differ by up to "
        f"{percent(PHASE_DIFFERENCE)} of the signal where a bit has two to four pixels, and by less than "
        f"{percent(FINE_DIFFERENCE)} where it has more.",
        f"The lens is focused at {c.ranges_m[-1]:g} m for good. Its defocus blurs the closed form's bits and the rendered frames "
        f"alike, as a Gaussian; the limit of {number(c.blur_bits_max)} bit on the disc is an assumption.",
        "The kind of LED is the scenario's. No measurement of tape at 850 nm or in orbit stands behind the first bar of the "
        "tornado, and sensors' and filters' presets are in part assumptions, each marked in its data file.",
    )
