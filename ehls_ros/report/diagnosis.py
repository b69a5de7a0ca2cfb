"""Report of a diagnosis: errors of the simulation, the evidence, the gain from correcting them, and open questions."""

from collections.abc import Callable
from pathlib import Path
from typing import get_args

from ehls_ros.diagnosis.free_run import Followed, FreeRun
from ehls_ros.diagnosis.result import Diagnosis, StageResult
from ehls_ros.diagnosis.rules import CLOSED
from ehls_ros.diagnosis.stages import Stage
from ehls_ros.experiments.consequences import NOTHING, Consequences
from ehls_ros.experiments.controller_benefit import ControllerBenefit, Steady
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Group
from ehls_ros.report import diagnosis_figures as drawn
from ehls_ros.report import diagnosis_findings as findings
from ehls_ros.report import page
from ehls_ros.report.diagnosis_baseline import learnt, old_and_new, since_sentence
from ehls_ros.report.diagnosis_causes import causes, measured_and_simulated, rivals, shares, unexplained, what_to_do
from ehls_ros.report.diagnosis_findings import STAGE_NAMES, words
from ehls_ros.report.diagnosis_term import found_term
from ehls_ros.report.diagnosis_term import sentence as term_sentence
from ehls_ros.report.page import MISSING_NUMBER, Entry, LeftOut, Panel, Row, listed, number, signed
from ehls_ros.report.quantities import change, percent, quantity

TITLES = {
    "effect": "Causes of the simulation's error",
    "partial": "Causes of a part of the simulation's error",
    "unknown": "The simulation is wrong, the cause unknown",
    "consistent": "The simulation agrees with the recording",
    "insufficient": "The data are insufficient",
}
"""Heading of the page by verdict."""

SINCE = {
    "effect": "Changes of the rig",
    "partial": "Changes of the rig, not all explained",
    "unknown": "Something has changed, the cause unknown",
    "consistent": "Nothing has changed",
    "insufficient": "The data are insufficient",
}
"""Heading of the page by verdict, for a recording judged against baselines."""


def answer(found: Diagnosis) -> tuple[str, bool | None]:
    """Return the result in a sentence, and whether all is well; None if the data are insufficient."""
    sentence, good = findings.verdict_sentence(found)
    term = "" if found.term is None else f" {term_sentence(found.term)}"
    return (sentence if found.baseline is None else since_sentence(found)) + term + findings.corrected(found), good


def write_diagnosis_report(found: Diagnosis, path: Path, follows: Consequences = NOTHING, source: str = "") -> None:
    """Write one self-contained HTML file that shows a diagnosis.

    Args:
        found: the diagnosis.
        path: file to write; its folder must exist.
        follows: consequences of the diagnosis; a result that is None is not shown.
        source: name of the diagnosed recording, for the line below the heading.
    """
    sentence, good = answer(found)
    rest = unexplained(found)
    limits = (*findings.runner_up_sentences(found), *findings.caveats(found, follows.remarks))
    parts = [
        ("Measured and simulated", measured_and_simulated(found)),
        ("Old and new", old_and_new(found)),
        ("Next steps", what_to_do(found)),
        ("Shares and sizes", shares(found)),
        ("The term found", found_term(found)),
        ("Other recordings", [page.bullets(checked)] if (checked := findings.check_sentences(follows.checks)) else []),
        ("Unexplained", [] if found.names_causes else rest),
        ("Runner-up and caveats" if found.names_causes else "Caveats", [page.bullets(limits)] if limits else []),
        ("Remainder", rest if found.names_causes else []),
        ("The cause" if len(found.causes) < 2 else "The causes", causes(found)),
        ("Stage by stage", _stages(found)),
        ("Alternatives", rivals(found)),
        ("The baselines", learnt(found)),
        ("Gain of the controller", [] if follows.controller is None else _benefit(follows.controller)),
        ("Next experiment", _next(follows)),
        ("Residuals against every signal", _residuals(found)),
        ("Free run", [] if follows.free_run is None else _free_run(follows.free_run)),
        ("Sensitivity", _sensitivity(found)),
        ("Method", [page.paragraph(_METHOD)]),
    ]
    page.write_page(
        path,
        title=(TITLES if found.baseline is None else SINCE)[found.verdict],
        subtitle=source,
        blocks=[page.verdict(sentence, good=good), *page.sections(parts)],
    )


def _stages(found: Diagnosis) -> list[str]:
    if not any(result.judged for result in found.stages.values()):
        return []
    compared = findings.compares(found)
    added = "extension" if found.causes else "partial causes" if found.term is None else "term found"
    extended = {f"with the {added}": lambda item: percent(item[1].nrmse_after)}
    columns: dict[str, Callable[[tuple[Stage, StageResult]], str | Entry]] = {
        "stage of the model": lambda item: Entry(STAGE_NAMES[item[0]], findings.COMPARED[item[0]]),
        "residual": lambda item: percent(item[1].nrmse_before),
        **(extended if compared else {}),
        "noise": lambda item: percent(item[1].noise_floor),
        "conclusion": lambda item: _conclusion(item[1]),
    }
    bars = [drawn.stage_bars(found)] if found.verdict != "insufficient" else []
    note = (
        "Residual: rms of the stage's imbalance as a fraction of its largest term; of several signals, the one that stands out"
        " most."
    )
    if compared:
        note += " The extended model is evaluated on segments it was not fitted to."
    return [page.figures(bars), page.table_of(found.stages.items(), columns), page.paragraph(note)]


def _conclusion(result: StageResult) -> str:
    depends = f"; depends on {listed([quantity(s) for s in result.depends_on])}" if result.depends_on else ""
    return f"{findings.left_over(result)}{depends}" if result.judged else f"not evaluated: {result.why_not}"


def _benefit(benefit: ControllerBenefit) -> list[str]:
    if not benefit.cases:
        return [
            page.paragraph(
                f"The benefit to the controller could not be evaluated: {benefit.reason or 'there is no case to run'}."
            )
        ]
    table = page.table_of(
        benefit.cases,
        {
            "largest steady force error": lambda case: case.case,
            "designed with the given model": lambda case: _steady(case.before),
            "designed with the extended model": lambda case: _steady(case.after),
            "change": lambda case: _change(case.before.max_error_n, case.after.max_error_n),
        },
    )
    text = "The force controller (FASMC, default tuning) on the extended plant, designed with either model:"
    if benefit.same_controller:
        text = (
            "The force controller (FASMC, default tuning) on the extended plant. The extension changes no coefficient that the"
            " law uses, so both runs have the same controller: only the simulation benefits."
        )
    return [page.paragraph(text), table]


def _change(before: float | None, after: float | None) -> str:
    return f"{signed(100.0 * (after / before - 1.0), 2)} %" if before and after is not None else MISSING_NUMBER


def _steady(run: Steady) -> str | Entry:
    if run.max_error_n is None:
        return run.trouble
    return Entry(f"{number(run.max_error_n)} N", f"rms {number(run.rms_error_n)} N")


def _next(follows: Consequences) -> list[str]:
    proposed = follows.next_experiment
    if proposed is None:
        text = f"No experiment of the catalogue would separate the open causes: {follows.no_experiment}."
        return [page.paragraph(text)] if follows.no_experiment else []
    pairs = page.table_of(
        proposed.separation,
        {
            "pair": lambda pair: f"{words(pair.one).noun} – {words(pair.other).noun}",
            "expected separation": lambda pair: f"{number(pair.sigma, 2)} σ",
        },
    )
    return [
        page.paragraph(
            f"To separate the open causes, record '{proposed.name}', {proposed.purpose}. {proposed.why.rstrip('.')}."
            " `ehls experiment next_experiment.yaml` runs it on the simulator; on the rig, follow its reference."
        ),
        pairs,
        page.collapsed("next_experiment.yaml", page.as_yaml(proposed.spec)),
    ]


def _residuals(found: Diagnosis) -> list[str]:
    panels: list[Panel | LeftOut] = [drawn.residuals_of(found, channel) for channel in findings.largest_first(found)]
    if not panels:
        return []
    note = (
        "Lines: means over classes of the signal. Bands: the middle 80 % of the windows. Dashed: 95 % of the"
        " noise. Last picture of each block: the spectrum. The residual"
        " of a correct model stays within the noise and depends on no signal."
    )
    return [page.paragraph(note), *(page.figures([panel]) for panel in panels), page.left_out(panels)]


def _free_run(run: FreeRun) -> list[str]:
    panel = drawn.free_run_panel(run)
    remarks = " ".join(f"{remark[0].upper()}{remark[1:].rstrip('.')}." for remark in run.remarks)
    text = (
        f"The first {number(float(run.time[-1]), 2)} s, simulated from the initial state with the recorded command and"
        f" disturbance only. {remarks}"
    )
    columns: dict[str, Callable[[Followed], str | Entry]] = {
        "signal": lambda signal: quantity(signal.name),
        "given model": lambda signal: percent(signal.nrmse_before),
    }
    if any(signal.after is not None for signal in run.signals):
        columns["extended model"] = lambda signal: percent(signal.nrmse_after)
    table = page.table_of(run.signals, columns)
    note = "Rms error as a fraction of the measured signal's standard deviation; a dash where the run was stopped."
    blocks = [page.paragraph(text), page.figures([panel]), page.left_out([panel])]
    return [*blocks, table, page.paragraph(note)] if table else blocks


def _sensitivity(found: Diagnosis) -> list[str]:
    blocks = []
    groups = get_args(Group)
    items = sorted(found.sensitivities, key=lambda item: (groups.index(EFFECTS.load(item.name).GROUP), item.name))
    if items:
        blocks.append(
            page.paragraph(
                "The smallest size at which nine of ten such recordings reveal an effect, for effects that grow with their size"
                " and were not named. For effects with a threshold, such as a stop, no such size can be predicted."
            )
        )
        # Several forms of an effect give the same result for a parameter they share.
        sizes = [change(item.smallest, item.unit) if findings.is_in_range(item) else "none in its range" for item in items]
        distinct = dict.fromkeys((item.name, item.parameter, size) for item, size in zip(items, sizes, strict=True))
        columns: dict[str, Callable[[tuple[str, str, str]], str | Entry]] = {
            "effect": lambda item: Entry(item[0], words(item[0]).noun),
            "parameter": lambda item: Entry(item[1], findings.parameter_meaning(item[0], item[1])),
            "smallest detectable size": lambda item: item[2],
        }
        blocks.append(page.table_of(distinct, columns))
    stages = [(stage, result) for stage, result in found.stages.items() if not result.judged]
    if (stages or found.not_judged) and found.verdict != "insufficient":
        named: list[Row] = [[STAGE_NAMES[stage], result.why_not] for stage, result in stages]
        named += [[Entry(name, words(name).noun), why] for name, why in found.not_judged.items()]
        blocks += [
            page.paragraph("Could not be evaluated from this recording:"),
            page.table(["stage or effect", "reason"], named),
        ]
    return blocks


_METHOD = (
    "Each stage of the model is compared with the recording separately and takes its inputs from the recording, so that the"
    " error of one stage does not spread to the others; balances are integrated over short windows, which avoids derivatives of"
    " noisy signals. The noise floor of every window is found by adding as much noise again as the sensors have. Every effect"
    " of the simulator is then fitted to some segments of the recording, alone and in combination, and evaluated on the others,"
    " so that a more flexible model wins only if it predicts. A cause is named if its gain exceeds chance, its parameter is"
    f" significantly different from neutral, and at most {100.0 * (1.0 - CLOSED):.0f} % of the error beyond the noise remains;"
    " the best alternatives are kept beside it. Where more remains, it is counted as noise and the causes are assessed again"
    " beside it: those that still matter are named, the verdict is 'partial'. Where none does, it is 'unknown'. The signals"
    " that predict the remainder are named."
)
"""Description of the method."""
