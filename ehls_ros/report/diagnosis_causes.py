"""Sections of a diagnosis report on causes: named ones with their rivals, an unknown one, or insufficient data."""

from ehls_ros.diagnosis.causes import advice as advice_for
from ehls_ros.diagnosis.result import Cause, Diagnosis
from ehls_ros.diagnosis.verdict import NEEDED_MOTION, NEEDED_SIGNALS
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.report import diagnosis_findings as findings
from ehls_ros.report import page
from ehls_ros.report.diagnosis_figures import share_bars
from ehls_ros.report.diagnosis_findings import STAGE_NAMES, words
from ehls_ros.report.diagnosis_residuals import over_signal, over_time, remaining, view_of_cause, views_of_rest
from ehls_ros.report.page import Entry, Row, listed
from ehls_ros.report.quantities import likely, percent, quantity

RIVALS = 4
"""Largest number of rivals listed for a cause."""


def measured_and_simulated(found: Diagnosis) -> list[str]:
    """Show measured and simulated signals over time in the channels with an error, otherwise in the force balance."""
    channels = [cause.channel for cause in found.causes if cause.channel in found.traces]
    channels += [view.channel for view in views_of_rest(found)]
    channels = channels or [channel for channel in ("force", *found.traces) if channel in found.traces][:1]
    drawn = page.figures(over_time(found, channel) for channel in dict.fromkeys(channels))
    return [drawn, page.paragraph(findings.noise_meaning(found))] if drawn else []


def what_to_do(found: Diagnosis) -> list[str]:
    """Show the next steps: for each cause from its file, for an unknown one by the signals it depends on."""
    blocks = []
    if found.causes:
        rows: list[Row] = [
            [Entry(cause.name, findings.noun_of(cause)), advice.inspect, advice.measure, advice.change]
            for cause in found.causes
            for advice in [advice_for(found.rig, cause)]
        ]
        blocks.append(page.table(["cause", "inspect", "confirm by a measurement", "then change"], rows))
    blocks += [page.bullets(steps)] if (steps := findings.next_steps(found)) else []
    if found.verdict == "insufficient":
        lacking = [stage for stage, result in found.stages.items() if not result.judged]
        needed: list[Row] = [
            [
                STAGE_NAMES[stage],
                NEEDED_SIGNALS[stage] if findings.lacks_signals(found, stage) else "recorded",
                NEEDED_MOTION[stage],
            ]
            for stage in lacking
        ]
        blocks.append(page.table(["stage of the model", "signals it needs", "excitation it needs"], needed))
    places: list[Row] = list(findings.where_to_look(found))
    return [*blocks, page.table(["the error depends on", "inspect"], places)] if places else blocks


def shares(found: Diagnosis) -> list[str]:
    """Show the error closed by the causes, the share and size of each, and the remainder."""
    bars = share_bars(found)
    blocks = [] if bars is None else [page.figures([bars]), page.paragraph(findings.gain_sentence(found))]
    if found.causes:
        header = ["cause", "stage", "probability", "share", "parameter", "value ± standard error", "in SI units"]
        blocks.append(page.table(header, [row for cause in found.causes for row in _parameters(cause)]))
    return blocks


def causes(found: Diagnosis) -> list[str]:
    """Show the named causes: the residual each one explains, and its equation."""
    views = dict.fromkeys(view for cause in found.causes if (view := view_of_cause(found, cause)) is not None)
    blocks = [page.figures(over_signal(found, view), columns=2) for view in views]
    if found.causes:
        about: list[Row] = [
            [cause.name, findings.meaning(cause.name), EFFECTS.load(cause.name).EQUATION] for cause in found.causes
        ]
        blocks.append(page.table(["cause", "meaning", "equation"], about))
    return blocks


def _parameters(cause: Cause) -> list[Row]:
    rows: list[Row] = []
    for index, (name, found) in enumerate(cause.parameters.items()):
        first = index == 0
        rows.append(
            [
                Entry(cause.name, findings.noun_of(cause)) if first else "",
                STAGE_NAMES[cause.stage] if first else "",
                likely(cause.probability) if first else "",
                "" if cause.share is None or not first else percent(cause.share),
                Entry(name, findings.parameter_meaning(cause.name, name)),
                findings.fitted(cause.name, name, found),
                f"{found.value:.5g} ± {found.std:.2g} {'' if found.unit == '1' else found.unit}".rstrip(),
            ]
        )
    for name, fixed in cause.fixed.items():
        parameter = Entry(name, findings.parameter_meaning(cause.name, name))
        rows.append(["", "", "", "", parameter, "fixed", f"{fixed:g}"])
    return rows


def rivals(found: Diagnosis) -> list[str]:
    """Show the other effects fitted instead of each cause, and why they were not named."""
    blocks = []
    for cause in found.causes:
        if not cause.rivals:
            continue
        rows: list[Row] = [
            [
                Entry(rival.name, words(rival.name).noun),
                "equal" if rival.name in cause.equivalent_to else findings.odds(rival),
                percent(rival.closed_fraction),
                findings.parameters_text(rival.name, rival.parameters, 2),
                findings.why_lost(cause, rival),
            ]
            for rival in cause.rivals[:RIVALS]
        ]
        header = [f"instead of {cause.name}", "odds against it", "closes", "with", "why it was not named"]
        blocks.append(page.table(header, rows))
    if blocks:
        blocks.append(
            page.paragraph(
                "Every other effect was fitted to the same data instead of each cause. Odds: how many times more probable the"
                " held-out data are with the cause. Closes: of the error that is left with all other causes in the model."
            )
        )
    return blocks


def unexplained(found: Diagnosis) -> list[str]:
    """Show an error that no effect explains, and the signals on which it depends."""
    if found.verdict not in ("partial", "unknown") or found.unknown_stage is None:
        return []
    blocks = [page.figures(remaining(found, views_of_rest(found)), columns=2)]
    if found.term is not None:
        blocks.append(page.paragraph("This is left beside the term found."))
        return blocks
    if found.depends_on:
        signals = listed([quantity(signal) for signal in found.depends_on])
        text = (
            f"These signals, the strongest first, predict the residual on data they were not fitted to: {signals}."
            " The residual is therefore not noise, and its model must contain them."
        )
    else:
        text = (
            "No signal alone predicts the residual on data it was not fitted to, and yet the residual exceeds the noise:"
            " look for an element with memory, or for one that depends on several signals together."
        )
    blocks.append(page.paragraph(text))
    if found.partial:
        rows: list[Row] = [[Entry(name, words(name).noun), findings.meaning(name)] for name in found.partial]
        blocks.append(page.paragraph("Explains a fraction of it, too little to be named as the cause:"))
        blocks.append(page.table(["effect", "meaning"], rows))
    return blocks
