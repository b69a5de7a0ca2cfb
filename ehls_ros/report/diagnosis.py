"""The report of a diagnosis: what the simulation gets wrong, how it is known, what mending it gains, and what stays open."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.diagnosis.evidence import TOLERANCE
from ehls_ros.diagnosis.free_run import FreeRun
from ehls_ros.diagnosis.result import Cause, Diagnosis
from ehls_ros.diagnosis.search import CLOSED
from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.report import diagnosis_figures as drawn
from ehls_ros.report import diagnosis_findings as findings
from ehls_ros.report.diagnosis_findings import STAGE_NAMES, words
from ehls_ros.report.diagnosis_units import estimate, likely, part, quantity
from ehls_ros.report.page import (
    MISSING_NUMBER,
    Entry,
    LeftOut,
    Panel,
    as_yaml,
    collapsed,
    contents,
    facts,
    figures,
    heading,
    left_out,
    listed,
    number,
    paragraph,
    signed,
    table,
    verdict,
    write_page,
)

RIVALS = 4
"""Most rivals of a cause that are listed."""


class Beside(NamedTuple):
    """What a report shows beside the diagnosis itself.

    Attributes:
        source: what was diagnosed, for the line below the heading.
        free_run: both models let go; None: not shown.
        controller: ``ControllerGains.as_json()``; None: not shown.
        next_experiment: ``NextExperiment.as_json()``; None: not shown.
        no_experiment: why there is no next experiment although causes are open.
        remarks: what could not be had.
    """

    source: str = ""
    free_run: FreeRun | None = None
    controller: Mapping[str, Any] | None = None
    next_experiment: Mapping[str, Any] | None = None
    no_experiment: str = ""
    remarks: Sequence[str] = ()


def write_diagnosis_report(found: Diagnosis, path: Path, beside: Beside = Beside()) -> None:  # noqa: B008 - it is immutable
    """Write one HTML file that shows a diagnosis and needs nothing else.

    Args:
        found: the diagnosis.
        path: file to write; its folder must exist.
        beside: what is shown beside it.
    """
    parts: list[tuple[str, Callable[[], list[str]]]] = [
        ("The cause" if len(found.causes) < 2 else "The causes", lambda: _causes(found)),
        ("What is left", lambda: _rest(found)),
        ("What is missing", lambda: _missing(found)),
        ("Part by part", lambda: _stages(found)),
        ("What else it could be", lambda: _rivals(found)),
        ("What it gains", lambda: _gain(found, beside)),
        ("The next experiment", lambda: _next(beside)),
        ("Left over against everything", lambda: _residuals(found)),
        ("Free run", lambda: _free_run(beside)),
        ("What would have been noticed", lambda: _noticed(found)),
        ("What to keep in mind", lambda: _caveats(found, beside)),
        ("How it works", lambda: [paragraph(_HOW)]),
    ]
    made = [(title, blocks) for title, make in parts if (blocks := [block for block in make() if block])]
    sentence, good = findings.verdict_sentence(found)
    write_page(
        path,
        title={
            "effect": "What the simulation gets wrong",
            "unknown": "The simulation is wrong, the cause unknown",
            "consistent": "The simulation agrees with the recording",
            "insufficient": "Nothing can be said of the simulation",
        }[found.verdict],
        subtitle=beside.source,
        blocks=[
            verdict(sentence, good=good),
            facts(_facts(found)),
            contents(title for title, _ in made),
            *(block for title, blocks in made for block in (heading(title), *blocks)),
        ],
    )


def _facts(found: Diagnosis) -> list[tuple[str, str]]:
    items: list[tuple[str, str]] = [("Verdict", found.verdict)]
    if found.causes:
        items.append(("Probability of the cause", likely(min(cause.probability for cause in found.causes))))
    if found.gain is not None:
        gain = found.gain
        items += [
            (f"Left over, {STAGE_NAMES[CHANNELS[gain.channel]]}", part(gain.heldout_nrmse_before)),
            ("With the extension", part(gain.heldout_nrmse_after)),
            ("Noise alone", part(gain.noise_floor)),
            ("Removable error that is gone", part(gain.closed_fraction)),
        ]
    elif found.unknown_stage is not None:
        result = found.stages[found.unknown_stage]
        name = STAGE_NAMES[found.unknown_stage]
        items += [(f"Left over, {name}", part(result.nrmse_after)), ("Noise alone", part(result.noise_floor))]
    judged = sum(result.judged for result in found.stages.values())
    items.append(("Parts of the model judged", f"{judged} of {len(found.stages)}"))
    return [*items, ("Time it took", f"{number(found.wall_s, 2)} s")]


# --- causes ------------------------------------------------------------------------------------


def _causes(found: Diagnosis) -> list[str]:
    if not found.causes:
        return []
    blocks = []
    seen: set[tuple[str, str]] = set()
    panels = []
    for cause in found.causes:
        view = drawn.view_of_cause(found, cause)
        if view is None or (view.channel, view.signal) in seen:
            continue
        seen.add((view.channel, view.signal))
        noun = words(cause.name).noun
        panels.append(drawn.residual_against(found, view, noun[0].upper() + noun[1:]))
    blocks += [figures([panel]) for panel in panels]
    rows: list[list[str | Entry]] = []
    for cause in found.causes:
        rows += _cause_rows(cause)
    header = ["cause", "where", "probability", "parameter", "value ± standard error", "in SI", "how sure"]
    blocks.append(table(header, rows))
    blocks += [
        paragraph(f"{cause.name}: {_sentence(findings.meaning(cause.name))} {EFFECTS.load(cause.name).EQUATION}.")
        for cause in found.causes
    ]
    return blocks


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."


def _cause_rows(cause: Cause) -> list[list[str | Entry]]:
    rows: list[list[str | Entry]] = []
    sure = "" if cause.sigmas <= 0.0 else f"{number(min(cause.sigmas, 1e6), 2)} standard errors from nothing"
    for index, (name, found) in enumerate(cause.parameters.items()):
        first = index == 0
        rows.append(
            [
                Entry(cause.name, words(cause.name).noun) if first else "",
                STAGE_NAMES[cause.stage] if first else "",
                likely(cause.probability) if first else "",
                Entry(name, findings.parameter_meaning(cause.name, name), prose=True),
                estimate(found),
                f"{found.value:.5g} ± {found.std:.2g} {'' if found.unit == '1' else found.unit}".rstrip(),
                sure if first else "",
            ]
        )
    for name, fixed in cause.fixed.items():
        rows.append(
            ["", "", "", Entry(name, findings.parameter_meaning(cause.name, name), prose=True), "held", f"{fixed:g}", ""]
        )
    return rows


def _rivals(found: Diagnosis) -> list[str]:
    blocks = []
    for cause in found.causes:
        if not cause.rivals:
            continue
        runner = findings.runner_up(cause)
        noun = words(cause.name).noun
        text = f"In the place of {noun}, every other effect was fitted to the same data."
        if runner is not None:
            text += (
                f" The runner-up is {words(runner.name).noun}: {findings.behind(runner)} nats behind on data held out;"
                f" it {findings.why_lost(cause, runner)}."
            )
        if cause.equivalent_to:
            names = listed([words(name).noun for name in cause.equivalent_to])
            text += f" With these data it cannot be told from {names}."
        blocks.append(paragraph(text))
        rows: list[list[str | Entry]] = [
            [
                Entry(rival.name, words(rival.name).noun),
                "as good" if rival.name in cause.equivalent_to else f"{findings.behind(rival)} behind",
                part(rival.closed_fraction),
                Entry(findings.parameters_text(rival.parameters, 2), prose=True),
                Entry(findings.why_lost(cause, rival), prose=True),
            ]
            for rival in cause.rivals[:RIVALS]
        ]
        header = [f"instead of {cause.name}", "held-out data, nats", "closes", "with", "why it was not named"]
        blocks.append(table(header, rows))
    if blocks:
        blocks.append(
            paragraph(
                "One nat behind makes a cause e times less likely; from about 10 on it no longer counts. What a rival closes is"
                " counted from the model with all other causes in place."
            )
        )
    return blocks


# --- unknown, missing --------------------------------------------------------------------------


def _rest(found: Diagnosis) -> list[str]:
    if found.verdict != "unknown" or found.unknown_stage is None:
        return []
    blocks = []
    view = drawn.view_of_rest(found)
    if view is not None:
        blocks.append(figures([drawn.residual_against(found, view, f"What is left of the {STAGE_NAMES[found.unknown_stage]}")]))
    if found.depends_on:
        signals = listed([quantity(signal) for signal in found.depends_on])
        text = (
            f"From these signals, strongest first, what is left can be foretold on data it was not fitted to: {signals}."
            " So it is no noise, and a model of it has to contain them."
        )
    else:
        text = (
            "No signal alone foretells what is left on data it was not fitted to, and yet it is more than noise: look for"
            " something with a memory, or that depends on several signals together."
        )
    blocks.append(paragraph(text))
    if found.partial:
        rows: list[list[str | Entry]] = [
            [Entry(name, words(name).noun), Entry(_sentence(findings.meaning(name)), prose=True)] for name in found.partial
        ]
        blocks.append(paragraph("Explains part of it, and too little to be named as the cause:"))
        blocks.append(table(["effect", "what it is"], rows))
    places: list[list[str | Entry]] = [[on, Entry(place, prose=True)] for on, place in findings.where_to_look(found)]
    blocks.append(table(["where it depends on", "look at"], places))
    return blocks


def _missing(found: Diagnosis) -> list[str]:
    rows = findings.to_record(found)
    if found.verdict == "insufficient":
        text = (
            "To be judged, a part of the model needs its signals, and a recording in which they move. A minute at 1 kHz of all"
            " signals, with slow and fast, small and large motion in both directions under changing load, tells most."
        )
        cells: list[list[str | Entry]] = [
            [stage, Entry(needs, prose=True), Entry(wanted, prose=True)] for stage, needs, wanted in rows
        ]
        return [paragraph(text), table(["part of the model", "signals it needs", "and what they have to do"], cells)]
    return []


# --- stages and gain ---------------------------------------------------------------------------


def _stages(found: Diagnosis) -> list[str]:
    if not any(result.judged for result in found.stages.values()):
        return []
    rows: list[list[str | Entry]] = []
    for stage, result in found.stages.items():
        depends = listed([quantity(s) for s in result.depends_on]) if result.depends_on else ""
        said = findings.left_over(result) + (f"; depends on {depends}" if depends else "")
        rows.append(
            [
                Entry(STAGE_NAMES[stage], findings.COMPARED[stage]),
                part(result.nrmse_before),
                *([part(result.nrmse_after)] if findings.compares(found) else []),
                part(result.noise_floor),
                Entry(said if result.judged else f"not judged: {result.why_not}", prose=True),
            ]
        )
    bars = [drawn.stage_bars(found)] if found.verdict != "insufficient" else []
    after = [] if not findings.compares(found) else ["with the extension" if found.causes else "with the part explained"]
    header = ["part of the model", "left over", *after, "noise alone", "what that says"]
    note = (
        "Left over: rms of what does not add up, as a part of the largest term of that balance; of several signals of a part"
        " the one that stands out most."
    )
    if findings.compares(found):
        note += " The extended model is judged on stretches it was not fitted to."
    return [figures(bars), table(header, rows), paragraph(note)]


def _gain(found: Diagnosis, beside: Beside) -> list[str]:
    if found.verdict != "effect":
        return []
    blocks = []
    gain = found.gain
    if gain is not None:
        low, high = gain.ci95
        blocks.append(
            paragraph(
                f"On data held out, the extension takes the {STAGE_NAMES[CHANNELS[gain.channel]]} from"
                f" {part(gain.heldout_nrmse_before)} to {part(gain.heldout_nrmse_after)} of its largest term; noise alone makes"
                f" {part(gain.noise_floor)}. Of the error that noise does not explain {part(gain.closed_fraction)} is gone"
                f" (95 % interval {part(low)} to {part(high)}, from resampling stretches of the recording), over all balances"
                " that the extension changes."
            )
        )
    return [*blocks, *_controller(beside.controller)]


def _controller(gains: Mapping[str, Any] | None) -> list[str]:
    if gains is None:
        return []
    cases = gains.get("cases") or ()
    if not cases:
        return [paragraph(f"What the controller gains could not be told: {gains.get('reason') or 'there is no case to run'}.")]

    def cell(run: Mapping[str, Any]) -> Entry:
        if run["max_error_n"] is None:
            return Entry(str(run["trouble"]), prose=True)
        return Entry(f"{number(run['max_error_n'])} N", f"rms {number(run['rms_error_n'])} N")

    rows: list[list[str | Entry]] = []
    for case in cases:
        before, after = case["before"], case["after"]
        told = before["max_error_n"] is not None and after["max_error_n"] is not None
        ratio = (
            f"{signed(100.0 * (after['max_error_n'] / before['max_error_n'] - 1.0), 2)} %"
            if told and before["max_error_n"]
            else MISSING_NUMBER
        )
        rows.append([str(case["case"]), cell(before), cell(after), ratio])
    text = "The force controller (FASMC, default tuning) on the extended plant, knowing the old model and knowing the new:"
    if gains.get("same_controller"):
        text = (
            "The force controller (FASMC, default tuning) on the extended plant. Nothing that its law knows of a rig has"
            " changed, so both runs have the same controller: the extension gives the simulation something, the law nothing."
        )
    header = ["largest steady force error", "built on the old model", "built on the new", "change"]
    return [paragraph(text), table(header, rows)]


def _next(beside: Beside) -> list[str]:
    proposed = beside.next_experiment
    if proposed is None:
        if not beside.no_experiment:
            return []
        text = f"No experiment of the catalogue would tell the open causes apart: {beside.no_experiment}."
        return [paragraph(text)]
    rows: list[list[str | Entry]] = [
        [f"{words(pair['one']).noun} – {words(pair['other']).noun}", f"{number(pair['sigma'], 2)} σ"]
        for pair in proposed["separation"]
    ]
    return [
        paragraph(
            f"To tell the open causes apart, record '{proposed['name']}', {proposed['purpose']}. {_sentence(proposed['why'])}"
            " `ehls experiment next_experiment.yaml` runs it on the simulator; on the rig, follow its reference."
        ),
        table(["pair", "expected separation"], rows),
        collapsed("next_experiment.yaml", as_yaml(proposed["spec"])),
    ]


# --- the rest ----------------------------------------------------------------------------------


def _residuals(found: Diagnosis) -> list[str]:
    panels: list[Panel | LeftOut] = [drawn.residuals_of(found, channel) for channel in findings.largest_first(found)]
    if not panels:
        return []
    note = (
        "Lines are means over classes of the signal, bands the middle 80 % of the windows, dashed ± 2 standard deviations of"
        f" noise, taken as {100.0 * TOLERANCE:g} % of the largest term at least; the last picture of each block is the"
        " spectrum. Where the model is right, all lies within the noise and follows nothing."
    )
    return [paragraph(note), *(figures([panel]) for panel in panels), left_out(panels)]


def _free_run(beside: Beside) -> list[str]:
    run = beside.free_run
    if run is None:
        return []
    panel = drawn.free_run_panel(run)
    extended = any(signal.after is not None for signal in run.signals)
    rows: list[list[str | Entry]] = [
        [quantity(signal.name), part(signal.nrmse_before), *([part(signal.nrmse_after)] if extended else [])]
        for signal in run.signals
    ]
    text = (
        f"The first {number(float(run.time[-1]), 2)} s simulated from the recorded command and disturbance alone, from the"
        " state at the start: nothing holds the models to the recording. "
        + " ".join(f"{_sentence(remark[0].upper() + remark[1:])}" for remark in run.remarks)
    )
    blocks = [paragraph(text), figures([panel]), left_out([panel])]
    if rows:
        header = ["signal", "as the model was given", *(["extended model"] if extended else [])]
        note = "Rms difference as a part of the measured signal's standard deviation; a dash where the run was given up."
        blocks += [table(header, rows), paragraph(note)]
    return blocks


_GROUPS = ("valve", "flow", "friction", "mechanics", "sensors", "environment")


def _noticed(found: Diagnosis) -> list[str]:
    blocks = []
    items = sorted(found.sensitivities, key=lambda item: (_GROUPS.index(EFFECTS.load(item.name).GROUP), item.name))
    if items:
        blocks.append(
            paragraph(
                "The smallest sizes that this recording would have shown, of effects that enter smoothly and were not found."
                " For effects with a threshold, such as a play or a stop, no such number can be given beforehand."
            )
        )
        rows: list[list[str | Entry]] = [
            [
                Entry(item.name, words(item.name).noun),
                Entry(item.parameter, findings.parameter_meaning(item.name, item.parameter), prose=True),
                findings.smallest_text(item),
            ]
            for item in items
        ]
        blocks.append(table(["effect", "parameter", "from this size on"], rows))
    stages = [(stage, result) for stage, result in found.stages.items() if not result.judged]
    if (stages or found.not_judged) and found.verdict != "insufficient":
        named = [(Entry(STAGE_NAMES[stage]), result.why_not) for stage, result in stages]
        named += [(Entry(name, words(name).noun), why) for name, why in found.not_judged.items()]
        unjudged: list[list[str | Entry]] = [[what, Entry(why, prose=True)] for what, why in named]
        blocks += [paragraph("Could not be judged from this recording:"), table(["what", "why"], unjudged)]
    return blocks


def _caveats(found: Diagnosis, beside: Beside) -> list[str]:
    return [paragraph(text) for text in findings.caveats(found, beside.remarks)]


_HOW = (
    "Each part of the model is laid beside the recording by itself, fed with what was recorded, so that an error of one does"
    " not smear over the others; balances are weighed over short windows, which needs no derivative of a noisy signal. What"
    " noise makes of every window is found by adding as much noise again as the sensors have. Every effect the simulator can"
    " switch on is then fitted, first alone and then beside others, on some stretches of the recording and judged on the rest,"
    " so that a more flexible model wins only if it foretells. A cause is named when it gains more than chance would, its"
    f" parameter is surely not neutral, and no more than {100.0 * (1.0 - CLOSED):.0f} % of what noise does not explain is left;"
    " what others do in its place is kept beside it. Where something is left that no effect closes the verdict is 'unknown',"
    " and the signals that foretell it are named."
)
"""How the verdict comes about."""
