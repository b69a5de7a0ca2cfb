"""Report of a dynamic force verification: a section for each block, with its table and figures."""

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from ehls_ros.experiments.verification.response import Band
from ehls_ros.experiments.verification.results import (
    CERTIFIES_NOTHING,
    Cyclic,
    Inertia,
    JudgedBlock,
    NonCyclic,
    Quantity,
    Refused,
    Verification,
)
from ehls_ros.report import page
from ehls_ros.report import verification_figures as drawn
from ehls_ros.report.page import MISSING_NUMBER, Row, number, signed, with_unit

SYMBOLS = {"n": "N", "deg": "°"}
"""Displayed units of quantities."""

BANDS_NOTE = (
    "Gain and lag of the force with respect to its reference, averaged over each band. Coherence: the fraction of the force's"
    " power that follows the reference linearly; noise, friction and saturation lower it."
)

MAX_DRAWN = 12
"""Maximum number of blocks with figures; the tables have all of them."""

NOTES = (
    "Peak, valley and range are those of the reference, delayed and scaled, plus the harmonics fitted to the rest.",
    "Mean, amplitude and phase are those of the fitted sine. Each is the mean over the cycles that were judged.",
    "Errors are measured less reference; a negative phase is a lag.",
    "Percentages are of the reference's range, and those of the amplitude of its amplitude.",
    "Uncertainties are expanded, k = 2; few cycles are enlarged by Student's factor.",
    "Scatter, fit and noise are three estimates of the same, the random part: the largest counts.",
)


def answer(found: Verification) -> tuple[str, bool | None]:
    """Return the result in a sentence, and None, since a verdict depends on the limits of the user's standard."""
    cyclic = [block for block in found.blocks if isinstance(block.found, Cyclic)]
    others = len(found.blocks) - len(cyclic)
    if not cyclic:
        [first, *more] = found.blocks
        one = first.found
        reason = one.reason if isinstance(one, NonCyclic | Refused) else ""
        rest = f" and {len(more)} more" if more else ""
        over_time = f" {_over_time(one)}" if isinstance(one, NonCyclic) and not more else ""
        return f"No block was judged by its cycles: {first.name}{rest} ({reason}).{over_time}", None
    amplitude, lag = _largest(cyclic, "amplitude"), _largest(cyclic, "phase")
    ranged = _largest(cyclic, "range")
    single = len(cyclic) == 1
    judged = "The block was judged by its" if single else f"{len(cyclic)} blocks were judged by their"
    text = (
        f"{judged} cycles: range off by {'' if single else 'at most '}{_percent(ranged)}, amplitude by {_percent(amplitude)}, "
        f"phase by {signed(lag.error)}° ± {number(lag.uncertainty.expanded, 2)}°"
    )
    rest = f"; {others} {'is' if others == 1 else 'are'} not cyclic" if others else ""
    return f"{text}{rest}. This certifies nothing.", None


def _over_time(one: NonCyclic) -> str:
    """Return the error over time in a sentence, with the response in the band where the reference is largest."""
    text = f"The force is off by {number(one.rms_error_n)} N rms and by {number(one.max_error_n)} N at most"
    if not one.bands:
        return f"{text}."
    main = max(one.bands, key=lambda band: band.reference_rms_n)
    return (
        f"{text}; from {number(main.low_hz, 2)} to {number(main.high_hz, 2)} Hz its gain is {number(main.gain, 4)}, its lag"
        f" {number(1e3 * main.lag_s)} ms, the coherence {number(main.coherence, 3)}."
    )


def _largest(blocks: list[JudgedBlock], name: str) -> Quantity:
    found: list[Quantity] = [getattr(block.found, name) for block in blocks]
    return max(found, key=lambda q: np.nan_to_num(abs(q.error if q.relative_to is None else q.percent)))


def _percent(quantity: Quantity) -> str:
    return f"{signed(quantity.percent)} ± {number(quantity.expanded_percent, 2)} %"


def write_verification_report(found: Verification, path: Path, source: str = "") -> None:
    """Write one self-contained HTML file that shows a verification.

    Args:
        found: the verification.
        path: file to write; its folder must exist.
        source: name of the verified recording, for the line below the heading.
    """
    sentence, good = answer(found)
    shown = [block for block in found.blocks if not isinstance(block.found, Refused)]
    pictured = {id(block) for block in shown[:MAX_DRAWN]}
    left = len(shown) - len(pictured)
    more = page.paragraph(f"Figures of {left} more blocks are left out.") if left else ""
    parts = [
        ("Blocks", [_overview(found)] if len(found.blocks) > 1 else []),
        *((block.name.capitalize(), list(_block(block, figures=id(block) in pictured))) for block in found.blocks),
        ("How it was made", [page.bullets((*NOTES, *found.remarks)), more]),
    ]
    page.write_page(
        path,
        title="Dynamic force verification",
        subtitle=source,
        blocks=[page.verdict(sentence, good=good), page.paragraph(CERTIFIES_NOTHING), *page.sections(parts)],
    )


def _overview(found: Verification) -> str:
    def cell(read: Callable[[Cyclic], str], missing: str = MISSING_NUMBER) -> Callable[[JudgedBlock], str]:
        return lambda block: read(block.found) if isinstance(block.found, Cyclic) else missing

    columns = {
        "": lambda block: block.name,
        "frequency [Hz]": cell(lambda one: number(one.frequency_hz, 4)),
        "cycles": cell(lambda one: number(one.cycles_judged), "0"),
        "peak [%]": cell(lambda one: _error(one.peak)),
        "valley [%]": cell(lambda one: _error(one.valley)),
        "mean [%]": cell(lambda one: _error(one.mean)),
        "amplitude [%]": cell(lambda one: _error(one.amplitude)),
        "phase [°]": cell(lambda one: _error(one.phase)),
        "distortion [%]": cell(lambda one: number(one.distortion.measured_percent)),
    }
    return page.table_of(found.blocks, columns)


def _error(quantity: Quantity) -> str:
    """Write an error with its expanded uncertainty, in percent or degrees."""
    if quantity.relative_to is None:
        return f"{signed(quantity.error)} ± {number(quantity.uncertainty.expanded, 2)}"
    return f"{signed(quantity.percent)} ± {number(quantity.expanded_percent, 2)}"


def _block(block: JudgedBlock, *, figures: bool) -> Iterator[str]:
    missing = f"{number(block.missing_percent)} % of its samples lack force or reference" if block.missing_percent else ""
    one = block.found
    if isinstance(one, Refused):
        yield page.paragraph(f"Not judged: {one.reason}.")
        return
    if isinstance(one, NonCyclic):
        yield page.paragraph(f"Judged by its error over time, for {one.reason}.")
        yield page.facts(
            [
                ("Start, length", f"{number(block.begin_s)} s, {number(block.duration_s)} s"),
                ("Samples", number(one.samples)),
                ("Mean error", f"{number(one.mean_error_n)} N"),
                ("RMS error", f"{number(one.rms_error_n)} N"),
                ("Largest error", f"{number(one.max_error_n)} N"),
                ("RMS error, last half", f"{number(one.last_half_rms_error_n)} N"),
                ("Largest error, last half", f"{number(one.last_half_max_error_n)} N"),
            ]
        )
        yield page.paragraph(f"{missing}.") if missing else ""
        if one.response is not None:
            yield page.table_of(one.bands, _BANDS)
            yield page.paragraph(BANDS_NOTE)
            yield page.figures([drawn.response(one.response)] if figures else [])
        return
    yield page.facts(_facts(block, one))
    yield page.bullets(_remarks(one, missing))
    yield _quantities(one)
    yield _cells(one)
    if isinstance(one.inertia, Inertia):
        yield _inertia(one.inertia)
    if figures:
        yield page.figures([drawn.one_cycle(one)])
        yield page.figures([drawn.trend(one), drawn.harmonics(one)], columns=2)


_BANDS: Mapping[str, Callable[[Band], str]] = {
    "band [Hz]": lambda band: f"{number(band.low_hz)} to {number(band.high_hz)}",
    "reference, rms [N]": lambda band: number(band.reference_rms_n),
    "error, rms [N]": lambda band: number(band.error_rms_n),
    "gain": lambda band: number(band.gain, 4),
    "lag [ms]": lambda band: number(1e3 * band.lag_s),
    "phase [°]": lambda band: signed(band.phase_deg),
    "coherence": lambda band: number(band.coherence),
}


def _facts(block: JudgedBlock, one: Cyclic) -> list[tuple[str, str]]:
    repeated, thd = one.repeatability, one.distortion
    return [
        ("Start, length", f"{number(block.begin_s)} s, {number(block.duration_s)} s"),
        ("Frequency", f"{number(one.frequency_hz, 4)} Hz"),
        ("Cycles judged", number(one.cycles_judged)),
        ("Passes", number(one.passes)),
        ("Scatter of peaks", with_unit(repeated.peak_std_n, "N")),
        ("Scatter of valleys", with_unit(repeated.valley_std_n, "N")),
        ("Scatter of the range", with_unit(repeated.range_std_n, "N")),
        ("Drift of peaks", _drift(repeated.peak_drift_n_per_cycle, repeated.peak_drift_expanded_n_per_cycle)),
        ("Drift of valleys", _drift(repeated.valley_drift_n_per_cycle, repeated.valley_drift_expanded_n_per_cycle)),
        ("Harmonic distortion", f"{number(thd.measured_percent)} ± {number(thd.expanded_percent, 2)} %"),
        ("Distortion of the reference", f"{number(thd.reference_percent if thd.reference_percent > 1e-6 else 0.0)} %"),
        ("Delay", with_unit(1e3 * one.delay_s, "ms")),
    ]


def _drift(value: float, expanded: float) -> str:
    return f"{signed(value)} ± {number(expanded, 2)} N/cycle" if math.isfinite(value) else MISSING_NUMBER


def _remarks(one: Cyclic, missing: str) -> Iterator[str]:
    """Yield remarks on omitted cycles and on the limits of the result."""
    for count, reason in (
        (one.cycles_settling, "at the start of their stretch, before the force has settled"),
        (one.cycles_incomplete, "for missing samples, a hold, or another length"),
        (one.cycles_unlike, "for another reference than the others'"),
    ):
        if count:
            yield f"{number(count)} {'cycle is' if count == 1 else 'cycles are'} left out {reason}."
    if not one.settled:
        yield "The force has not settled: the cycles that are judged still change."
    if one.cycles_judged == 1:
        yield "One cycle gives no repeatability: the uncertainty is that of the fit."
    if missing:
        yield f"{missing}."
    if math.isfinite(one.sensor_phase_deg) and one.sensor_phase_deg:
        yield f"Of the phase, {signed(one.sensor_phase_deg)}° are the force sensor's, by the rig file; they are not corrected."
    if isinstance(one.inertia, Refused):
        yield f"The load cell's inertia is not corrected: {one.inertia.reason}."


def _quantities(one: Cyclic) -> str:
    return page.table_of(
        one.quantities,
        {
            "": lambda q: q.name,
            "reference": lambda q: f"{number(_reference(q), 5)} {SYMBOLS[q.unit]}",
            "measured": lambda q: f"{number(q.measured, 5)} {SYMBOLS[q.unit]}",
            "error": lambda q: f"{signed(q.error)} ± {number(q.uncertainty.expanded, 2)} {SYMBOLS[q.unit]}",
            "error [%]": lambda q: MISSING_NUMBER if q.relative_to is None else _error(q),
        },
    )


def _reference(quantity: Quantity) -> float:
    """Return the reference, as zero where it is insignificant."""
    return 0.0 if abs(quantity.reference) < 1e-3 * quantity.uncertainty.expanded else quantity.reference


def _cells(one: Cyclic) -> str:
    """Return the uncertainty budget: standard uncertainties by origin."""
    header = ["standard uncertainty of", "scatter (A)", "fit (A)", "noise (B)", "resolution (B)", "cell (B)", "waveform (B)",
              "combined"]  # fmt: skip
    rows: list[Row] = [
        [q.name, *(with_unit(part, SYMBOLS[q.unit]) for part in (*q.uncertainty, q.uncertainty.standard))]
        for q in one.quantities
    ]
    return page.table(header, rows)


def _inertia(found: Inertia) -> str:
    amplitude, phase = found.amplitude, found.phase
    return page.paragraph(
        f"Inertia of {number(found.mass_kg)} kg between load cell and specimen: {number(found.force_n)} ± "
        f"{number(found.force_expanded_n, 2)} N at the fundamental, {number(found.percent)} % of the amplitude, at "
        f"{signed(found.phase_deg)}° to the measured force. Without it, the specimen's amplitude is off by "
        f"{signed(amplitude.error)} ± {number(amplitude.uncertainty.expanded, 2)} N ({_percent(amplitude)}), its phase by "
        f"{signed(phase.error)}° ± {number(phase.uncertainty.expanded, 2)}°."
    )
