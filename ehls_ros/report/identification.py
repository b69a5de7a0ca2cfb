"""Report of an identification: the coefficients, their uncertainty, and the data beside the fit."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ehls_ros.estimate import Estimate
from ehls_ros.identification.result import Identification
from ehls_ros.physics.rig import Rig
from ehls_ros.progress import duration_text
from ehls_ros.report import identification_figures as drawn
from ehls_ros.report import identification_findings as findings
from ehls_ros.report import page
from ehls_ros.report.page import MISSING_NUMBER, Entry, LeftOut, Panel, listed, number, paragraph, signed, table_of
from ehls_ros.report.quantities import as_shown, unit_text, written

RECORDINGS = 6
"""Maximum number of recordings for which the joint fit is drawn."""

NO_CORRELATION, ALMOST_ONE = 5e-3, 0.995
"""Correlations below and above which two decimals would round to 0 and 1."""

NAMED = 4
"""Maximum number of recordings named in the line below the heading."""


def write_identification_report(found: Identification, path: Path, *, before: Rig | None = None) -> None:
    """Write a self-contained HTML file that shows an identification.

    Args:
        found: the result; a figure without data is left out, with the reason.
        path: file to write; its folder must exist.
        before: the rig before the identification, shown beside the new values; None: not shown.
    """
    parts = [
        ("Coefficients", _coefficients(found, before)),
        ("Static friction", _static(found)),
        ("Presliding", _presliding(found)),
        ("Joint fit", _joint(found)),
        ("Correlations", _correlations(found)),
        ("Search", _drawn([drawn.convergence(found)])),
        ("How it was made", _making(found)),
    ]
    names = [motion.name for motion in found.motions]
    more = [f"{len(names) - NAMED} more"] if len(names) > NAMED else []
    subtitle = f"from {listed([*names[:NAMED], *more])}" if names else ""
    sentence, good = findings.verdict_sentence(found)
    blocks = [page.verdict(sentence, good=good), *page.sections(parts)]
    page.write_page(path, title="Friction identified", subtitle=subtitle, blocks=blocks)


def _drawn(panels: Sequence[Panel | LeftOut], columns: int = 1) -> list[str]:
    """Return figures, and the list of those that could not be drawn."""
    return [page.figures(panels, columns=columns), page.left_out(panels)]


def _coefficients(found: Identification, before: Rig | None) -> list[str]:
    rounded = {name: written(e.value, e.std) for name, e in found.estimates.items()}
    columns: dict[str, Callable[[tuple[str, Estimate]], str | Entry]] = {
        "coefficient": lambda item: _named(found, item[0]),
        "": lambda item: findings.symbol(item[0]),
        "value": lambda item: Entry(rounded[item[0]].value, _in_other_unit(item[1])),
        "standard error": lambda item: rounded[item[0]].error,
        "in % of the value": lambda item: findings.relative_error(item[1]),
        "95 % interval": lambda item: rounded[item[0]].interval,
        "unit": lambda item: unit_text(item[1].unit),
    }
    if before is not None:
        columns["rig file before"] = lambda item: _before(*item, found, before)
    missing = table_of(
        findings.not_identified(found),
        {
            "coefficient": lambda entry: _named(found, entry.name),
            "": lambda entry: findings.symbol(entry.name),
            "in the new rig file": lambda entry: Entry(entry.value, heat=0.4),
            "why it is not identifiable": lambda entry: entry.reason,
        },
    )
    remarks = map(paragraph, findings.other_remarks(found))
    heading = paragraph("Not identifiable from these data:") if missing else ""
    return [table_of(found.estimates.items(), columns), heading, missing, *remarks]


def _named(found: Identification, name: str) -> Entry:
    return Entry(name, findings.meaning(found.rig, name))


def _in_other_unit(estimate: Estimate) -> str:
    """Write the value in the unit of the figures, if that is another one."""
    return findings.readable(estimate, digits=2).split(" ±")[0] if estimate.unit in findings.READABLE else ""


def _before(name: str, estimate: Estimate, found: Identification, before: Rig) -> Entry:
    base, index = findings.split(name)
    if index:
        count = len(getattr(before.friction, base))
        if count != len(getattr(found.fit.friction, base)):
            return Entry(MISSING_NUMBER, f"{count} element{'s' if count > 1 else ''}")
    old = findings.value_in(before, name)
    if not isinstance(old, float):
        return Entry(MISSING_NUMBER)
    change = estimate.value / old - 1 if old else math.nan
    if not math.isfinite(change):
        return Entry(as_shown(old))
    return Entry(as_shown(old), f"{signed(100 * change, 2)} %" if abs(change) >= 1e-5 else "unchanged")


def _static(found: Identification) -> list[str]:
    curves = [drawn.stribeck(found), drawn.stribeck_slow(found)]
    residuals = [drawn.static_residuals(found)]
    return [page.figures(curves, columns=2), page.figures(residuals), page.left_out([*curves, *residuals])]


def _presliding(found: Identification) -> list[str]:
    panels = [drawn.hysteresis(found), *([drawn.branch(found)] if found.elements else [])]
    if found.branch is None or not found.nodes:
        return _drawn(panels, columns=len(panels))
    static_force = found.fit.friction.static_force
    nodes = table_of(
        enumerate(zip(found.nodes, drawn.element_stiffness(found), strict=True), start=1),
        {
            "node": lambda item: f"N{item[0]}",
            "travel": lambda item: f"{number(1e3 * item[1][0].way, 4)} mm",
            "force gained": lambda item: f"{number(item[1][0].force, 4)} N",
            "slope before it, Ki": lambda item: f"{number(1e-3 * item[1][0].slope, 4)} N/mm",
            "element stiffness, ki": lambda item: f"{number(1e-3 * item[1][1], 4)} N/mm",
            "element weight, αi": lambda item: number(0.5 * item[1][1] * item[1][0].way / static_force, 3),
        },
    )
    text = "The ramps end at 2 αi Fs, as at standstill. In motion friction is lower, and the branch bends a little earlier."
    return [paragraph(findings.criteria_remark(found)), *_drawn(panels, columns=2), nodes, paragraph(text)]


def _joint(found: Identification) -> list[str]:
    remark = findings.noise_remark(found)
    blocks = [paragraph(remark)] if remark else []
    all_of_them = list(zip(found.motions, found.fit.residuals, found.fit.noise, strict=True))
    missing: list[Panel | LeftOut] = []
    for motion, residual, noise in all_of_them[:RECORDINGS]:
        excerpt = drawn.excerpt(motion, residual, noise)
        blocks += [page.figures([excerpt]), page.figures(drawn.residuals(motion, residual), columns=2)]
        missing.append(excerpt)
    missing += [
        LeftOut(f"Joint fit: {m.name}", f"only {RECORDINGS} recordings are drawn") for m, *_ in all_of_them[RECORDINGS:]
    ]
    return [*blocks, page.left_out(missing)]


def _correlations(found: Identification) -> list[str]:
    names = list(found.estimates)
    if not names:
        return []
    symbols = [findings.symbol(name) for name in names]
    rows: list[list[str | Entry]] = [
        [symbols[i], *(_correlation(float(found.correlations[i, j]), same=i == j) for j in range(len(names)))]
        for i in range(len(names))
    ]
    remark = findings.correlation_remark(found)
    return [*([paragraph(remark)] if remark else []), page.table(["", *symbols], rows)]


def _correlation(value: float, *, same: bool) -> Entry:
    if same or not math.isfinite(value):
        return Entry("1" if same else MISSING_NUMBER)
    if abs(value) < NO_CORRELATION:
        return Entry("0")
    return Entry(f"{value:+.{2 if abs(value) < ALMOST_ONE else 4}f}".replace("-", "−"), heat=value)


def _making(found: Identification) -> list[str]:
    static, fit = found.static, found.fit
    search = static.search if static is not None else None
    items = [
        ("Optimiser of the static fit", found.method if search is not None else ""),
        ("Its evaluations", number(search.evaluations) if search is not None else ""),
        ("Settling time", f"{number(static.settle_time, 2)} s" if static is not None else ""),
        ("Friction model", found.rig.friction_model),
        ("Friction elements", number(found.elements) if found.elements else ""),
        ("Branches averaged", number(found.branch.branches) if found.branch is not None else ""),
        ("Independent blocks", number(round(fit.blocks)) if math.isfinite(fit.blocks) else ""),
        ("Wall time", duration_text(found.wall_s)),
    ]
    recordings = table_of(
        zip(found.motions, fit.residuals, fit.noise, strict=True),
        {
            "recording": lambda item: item[0].name,
            "length": lambda item: f"{number(len(item[0].time) * item[0].period, 4)} s",
            "block": lambda item: f"{as_shown(1e3 * item[0].period)} ms",
            "blocks": lambda item: number(len(item[0].time)),
            "counted": lambda item: f"{number(100 * float(np.mean(np.isfinite(item[1]))) if len(item[1]) else 0.0, 2)} %",
            "outliers or missing": lambda item: f"{number(100 * item[0].outliers, 2)} %",
            "noise of a block's force": lambda item: f"{number(item[0].force_noise)} N",
            "residual": lambda item: f"{number(item[2])} N",
        },
    )
    text = (
        "Position and force are averaged over blocks; velocity and acceleration are derivatives of a local cubic. The joint"
        f" fit searched for {listed(list(fit.free)) if fit.free else 'nothing'} and solved for"
        f" {listed(list(fit.linear_names))}. Blocks with residuals that are too large are left out; correlated blocks count"
        " once."
    )
    return [paragraph(text), page.facts(items), recordings]
