"""What a diagnosis against baselines says and shows: the sentence, old and new side by side, and what the baselines tell."""

from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.result import BaselineSummary, ChannelTrace, Diagnosis
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.report import page
from ehls_ros.report.diagnosis_figures import curve
from ehls_ros.report.diagnosis_findings import CHANNEL_NAMES, STAGE_NAMES, parameters_text, words
from ehls_ros.report.diagnosis_units import estimate, percent, quantity, shown_signal, unit_for
from ehls_ros.report.diagnosis_views import BINS, NATURAL, classes, explained
from ehls_ros.report.page import Entry, Panel, Row, listed, number
from ehls_ros.report.plot import BLACK, BLUE, GREY, VERMILION, Axis, Trace, packed, plane_layout

OLD, NEW, OWN = "baseline", "new recording", "the rig's own remainder, as learnt, at the new recording's points"

POINTS = 1500
"""Largest number of dots of one recording."""

ONE_VIEW = "velocity_m_s"
"""Signal of the picture where nothing has changed."""


def since_sentence(found: Diagnosis) -> str:
    """Say in a sentence or two what has changed since the baselines."""
    since = _since(found.baseline)
    if found.verdict == "consistent":
        judged = listed([STAGE_NAMES[stage] for stage, result in found.stages.items() if result.judged])
        text = f"Nothing has changed since {since} that shows: {judged} differ by no more than noise and natural spread"
        return f"{text}. The smallest changes that would have shown are listed under 'Sensitivity'."
    if found.names_causes:
        said = listed([_change(found, index) for index in range(len(found.causes))])
        more = "; more has changed that no known effect explains" if found.verdict == "partial" else ""
        return f"Since {since}, there is a change: {said}{more}."
    if found.verdict == "unknown" and found.unknown_stage is not None:
        signals = listed([quantity(s) for s in found.depends_on]) if found.depends_on else "no recorded signal alone"
        text = (
            f"Since {since}, the {STAGE_NAMES[found.unknown_stage]} has changed, and no known effect explains how; the change"
        )
        return f"{text} depends on {signals}."
    missing = listed([STAGE_NAMES[stage] for stage, result in found.stages.items() if not result.judged])
    return f"The data are insufficient to tell what has changed since {since}: {missing} cannot be evaluated."


def _since(baseline: BaselineSummary | None) -> str:
    count = 0 if baseline is None else len(baseline.recordings)
    return "the baseline" if count == 1 else f"the {count} baselines"


def _change(found: Diagnosis, index: int) -> str:
    cause = found.causes[index]
    noun = words(cause.name).noun
    others = f", or {' or '.join(words(name).noun for name in cause.equivalent_to)}" if cause.equivalent_to else ""
    return f"{noun} ({parameters_text(cause.parameters)}){others}" if cause.parameters else f"{noun}{others}"


def changes(found: Diagnosis) -> list[str]:
    """Show old and new side by side, what the baselines told of the rig, and how far they cover the recording."""
    baseline = found.baseline
    if baseline is None:
        return []
    channel = _main_channel(found, baseline)
    panels = [] if channel is None else [side_by_side(found, baseline, channel)]
    return [page.figures(panels), *_channels(baseline), *_coefficients(baseline), *_coverage(baseline)]


def side_by_side(found: Diagnosis, baseline: BaselineSummary, channel: Channel) -> Panel:
    """Draw what the fitted model leaves in the baseline and in the new recording, over the signal that tells them apart."""
    old, new = baseline.old[channel], baseline.new[channel]
    signal = _signal(found, channel, old, new)
    unit = unit_for(new.unit, float(np.quantile(np.abs(np.concatenate([old.before, new.before])), 0.98)))
    traces: list[Trace] = []
    for trace, name, color in ((old, OLD, GREY), (new, NEW, VERMILION)):
        x = shown_signal(signal, trace.against[signal]).values
        thinned = slice(None, None, max(1, -(-len(x) // POINTS)))
        marker = {"color": color, "size": 3.5, "opacity": 0.3}
        dots = {"type": "scatter", "mode": "markers", "name": name, "marker": marker, "hoverinfo": "skip"}
        traces.append(dots | {"x": packed(x[thinned]), "y": packed((trace.before * unit.factor)[thinned])})
    for trace, residual, name, color in (
        (old, old.before, f"mean, {OLD}", BLACK),
        (new, new.before, f"mean, {NEW}", VERMILION),
        (new, new.before - new.after, OWN, BLUE),
    ):
        x = shown_signal(signal, trace.against[signal]).values
        means, middles, _ = classes(x, residual * unit.factor, BINS)
        line = {"color": color, "width": 2.2, "dash": "dash" if name == OWN else "solid"}
        traces.append(curve(middles, means, name, unit, color) | {"line": line})
    both = np.concatenate([old.against[signal], new.against[signal]])
    shown = shown_signal(signal, both)
    span = _span([old.before * unit.factor, new.before * unit.factor])
    layout = plane_layout(
        Axis(shown.quantity, shown.unit, (float(np.min(shown.values)), float(np.max(shown.values)))),
        Axis(f"residual, {CHANNEL_NAMES[channel]}", unit, span),
    )
    layout["legend"] |= {"itemsizing": "constant"}
    note = "Both are residuals of the model fitted to the baselines. A change is where the means part from what was learnt."
    return Panel("Old and new", traces, layout, note, height=460, over_time=False)


def _span(residuals: Sequence[Array]) -> tuple[float, float]:
    low, high = (float(np.quantile(np.concatenate(residuals), part)) for part in (0.002, 0.998))
    air = 0.1 * (high - low) or 1.0
    return low - air, high + air


def _main_channel(found: Diagnosis, baseline: BaselineSummary) -> Channel | None:
    """Return the channel that shows the change best; without one, that of the force balance or the first."""
    both = [c for c in baseline.new if c in baseline.old and c in found.traces]
    stage = found.causes[0].stage if found.causes else found.unknown_stage
    stages = [c for c in both if CHANNELS[c] == stage] or ([] if stage is None else both)
    if stages:
        return max(stages, key=lambda c: float(np.mean((found.traces[c].before / found.traces[c].floor) ** 2)))
    return "force" if "force" in both else next(iter(both), None)


def _signal(found: Diagnosis, channel: Channel, old: ChannelTrace, new: ChannelTrace) -> str:
    """Return the signal that explains most of what has changed."""
    shared = [s for s, values in new.against.items() if s in old.against and float(np.ptp(values)) > 0.0]
    if not (found.causes or found.unknown_stage) and ONE_VIEW in shared:
        return ONE_VIEW
    best = {s: explained(new.against[s], new.after) for s in shared}
    preferred = NATURAL[EFFECTS.load(found.causes[0].name).GROUP] if found.causes else ()
    most = max(best.values())
    return next((s for s in preferred if best.get(s, 0.0) > 0.5 * most), max(best, key=lambda s: best[s]))


def _channels(baseline: BaselineSummary) -> list[str]:
    rows: list[Row] = [
        [
            Entry(STAGE_NAMES[item.stage], CHANNEL_NAMES[channel]),
            percent(item.fitted),
            percent(item.left),
            percent(item.noise_floor),
            percent(item.allowed),
        ]
        for channel, item in baseline.channels.items()
    ]
    header = ["stage of the model", "fitted model", "less the rig's own remainder", "noise floor", "allowed for"]
    text = (
        f"The rig file was fitted to {listed(list(baseline.recordings))}. What the fit leaves there is the rig's own remainder;"
        " what it was learnt from leaves out one block after the other. Allowed for: how far the new recording may be off"
        " without any change, from what the baselines leave open and from the natural spread. All are rms, as fractions of the"
        " balance's largest term in the baselines."
    )
    return [page.paragraph(text), page.table(header, rows)]


def _coefficients(baseline: BaselineSummary) -> list[str]:
    rows: list[Row] = [
        [name, f"{number(item.given)}", estimate(item.fitted), f"± {percent(item.spread)}"]
        for name, item in baseline.coefficients.items()
    ]
    header = ["coefficient", "rig file", "fitted to the baselines", "spread that is no change"]
    return [page.table(header, rows)] if rows else []


def _coverage(baseline: BaselineSummary) -> list[str]:
    rows: list[Row] = []
    for item in baseline.coverage:
        ends = shown_signal(item.signal, np.array([*item.baseline, *item.new]))
        low, high, here, there = (number(v) for v in ends.values)
        rows.append([ends.quantity, f"{low} to {high}", f"{here} to {there}", ends.unit.symbol, percent(item.beyond)])
    header = ["signal", "baselines", "new recording", "unit", "outside what is covered"]
    return [page.table(header, rows)] if rows else []
