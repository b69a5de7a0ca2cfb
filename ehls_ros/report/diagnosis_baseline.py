"""Sections of a diagnosis against baselines: the verdict, old and new side by side, and the learnt coefficients."""

import numpy as np

from ehls_ros.diagnosis.result import BaselineSummary, ChannelTrace, Diagnosis
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.report import page
from ehls_ros.report.diagnosis_findings import CHANNEL_WORDS, STAGE_NAMES, claims, depends, rest_of, sentence_of, visible
from ehls_ros.report.diagnosis_residuals import PREFERRED_SIGNALS, Cloud, explained, planes
from ehls_ros.report.page import Entry, Row, listed, number
from ehls_ros.report.plot import GREY, VERMILION
from ehls_ros.report.quantities import estimate, percent, shown_signal, value

EXPECTED = "expected"
"""Name of the curve expected without a change."""

ONE_VIEW = "velocity_m_s"
"""Signal of the figure if nothing has changed."""


def since_sentence(found: Diagnosis) -> str:
    """Return a sentence on the change since the baselines."""
    count = 0 if found.baseline is None else len(found.baseline.recordings)
    since = "the baseline" if count == 1 else f"the {count} baselines"
    judged = listed([STAGE_NAMES[stage] for stage, result in found.stages.items() if result.judged] or ["nothing"])
    missing = listed([STAGE_NAMES[stage] for stage, result in found.stages.items() if not result.judged])
    if found.verdict == "consistent":
        text = f"Nothing has changed since {since}: {judged} differ by no more than noise and natural spread"
        return (f"{text}; {missing} cannot be evaluated." if missing else f"{text}.") + visible(found)
    if found.names_causes:
        rest = rest_of(found) if found.verdict == "partial" else []
        return sentence_of([f"since {since}, {claims(found, 'then')}", *rest])
    if found.verdict == "unknown":
        where = "rig" if found.unknown_stage is None else STAGE_NAMES[found.unknown_stage]
        return f"Since {since}, the {where} has changed; the change {depends(found)}, and no known effect explains it."
    return f"The data are insufficient to find changes since {since}: {missing} cannot be evaluated."


def old_and_new(found: Diagnosis) -> list[str]:
    """Show the residuals of the fitted model in the baseline and in the new recording, side by side."""
    baseline = found.baseline
    channel = None if baseline is None else _main_channel(found, baseline)
    if baseline is None or channel is None:
        return []
    old, new = baseline.old[channel], baseline.new[channel]
    signal = _signal(found, channel, old, new)
    before, now = old.against[signal], new.against[signal]
    name = f"Baseline{'' if len(baseline.recordings) == 1 else ', the first'}"
    clouds = [
        Cloud(name, GREY, before, old.before, old.floor, {EXPECTED: (before, old.before - old.after)}),
        Cloud(
            "New recording",
            VERMILION,
            now,
            new.before,
            new.floor,
            {EXPECTED: (now, new.before - new.after), "mean, baseline": (before, old.before)},
        ),
    ]
    text = (
        "Both are residuals of the model fitted to the baselines. Expected: its residuals if nothing has changed. A"
        " change is where the mean departs from that."
    )
    return [page.figures(planes(channel, signal, new.unit, clouds), columns=2), page.paragraph(text)]


def learnt(found: Diagnosis) -> list[str]:
    """Show the coefficients and remainders learnt from the baselines, and their coverage of the recording."""
    baseline = found.baseline
    return [] if baseline is None else [*_channels(baseline), *_coefficients(baseline), *_coverage(baseline)]


def _main_channel(found: Diagnosis, baseline: BaselineSummary) -> Channel | None:
    """Return the channel that shows the change best; without a change, the force balance or the first channel."""
    both = [c for c in baseline.new if c in baseline.old and c in found.traces]
    stage = found.causes[0].stage if found.causes else found.unknown_stage
    stages = [c for c in both if CHANNELS[c] == stage] or ([] if stage is None else both)
    if stages:
        return max(stages, key=lambda c: float(np.mean((found.traces[c].before / found.traces[c].floor) ** 2)))
    return "force" if "force" in both else next(iter(both), None)


def _signal(found: Diagnosis, channel: Channel, old: ChannelTrace, new: ChannelTrace) -> str:
    """Return the signal that explains most of the change."""
    shared = [s for s, values in new.against.items() if s in old.against and float(np.ptp(values)) > 0.0]
    if not (found.causes or found.unknown_stage) and ONE_VIEW in shared:
        return ONE_VIEW
    best = {s: explained(new.against[s], new.after) for s in shared}
    preferred = PREFERRED_SIGNALS[EFFECTS.load(found.causes[0].name).GROUP] if found.causes else ()
    most = max(best.values())
    return next((s for s in preferred if best.get(s, 0.0) > 0.5 * most), max(best, key=lambda s: best[s]))


def _channels(baseline: BaselineSummary) -> list[str]:
    table = page.table_of(
        baseline.channels.items(),
        {
            "stage of the model": lambda item: Entry(STAGE_NAMES[item[1].stage], CHANNEL_WORDS[item[0]].residual),
            "fitted model": lambda item: percent(item[1].fitted),
            "less the rig's remainder": lambda item: percent(item[1].left),
            "noise": lambda item: percent(item[1].noise_floor),
            "allowed for": lambda item: percent(item[1].allowed),
        },
    )
    text = (
        f"The rig file was fitted to {listed(list(baseline.recordings))}. The residual of the fit there is the rig's remainder;"
        " it is learnt with one block after the other left out. Allowed for: the deviation of the new recording"
        " without any change, from the uncertainty of the baselines and the natural spread. All are rms, as fractions of the"
        " balance's largest term in the baselines."
    )
    return [page.paragraph(text), table]


def _coefficients(baseline: BaselineSummary) -> list[str]:
    table = page.table_of(
        baseline.coefficients.items(),
        {
            "coefficient": lambda item: item[0],
            "rig file": lambda item: value(item[1].given, item[1].fitted.unit),
            "fitted to the baselines": lambda item: estimate(item[1].fitted),
            "spread that is no change": lambda item: "" if item[1].spread is None else f"± {percent(item[1].spread)}",
        },
    )
    return [table]


def _coverage(baseline: BaselineSummary) -> list[str]:
    rows: list[Row] = []
    for item in baseline.coverage:
        ends = shown_signal(item.signal, np.array([*item.baseline, *item.new]))
        low, high, here, there = (number(v) for v in ends.values)
        rows.append([ends.quantity, f"{low} to {high}", f"{here} to {there}", ends.unit.symbol, percent(item.beyond)])
    header = ["signal", "baselines", "new recording", "unit", "outside the baselines"]
    return [page.table(header, rows)] if rows else []
