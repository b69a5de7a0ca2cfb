"""Report of an identification: the coefficients, their uncertainty, and the data beside the fit."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ehls_ros.estimate import Estimate
from ehls_ros.identification.result import Identification
from ehls_ros.physics.rig import Rig
from ehls_ros.report import identification_figures as drawn
from ehls_ros.report import identification_findings as findings
from ehls_ros.report.page import (
    MISSING_NUMBER,
    Entry,
    LeftOut,
    Panel,
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
    parts: list[tuple[str, Callable[[], list[str]]]] = [
        ("Coefficients", lambda: _coefficients(found, before)),
        ("Static friction", lambda: _static(found)),
        ("Presliding", lambda: _presliding(found)),
        ("Joint fit", lambda: _joint(found)),
        ("Correlations", lambda: _correlations(found)),
        ("Search", lambda: _search(found)),
        ("How it was made", lambda: _making(found)),
    ]
    made = [(title, blocks) for title, make in parts if (blocks := [block for block in make() if block])]
    sentence, good = findings.verdict_sentence(found)
    write_page(
        path,
        title="Friction identified",
        subtitle=_subtitle(found),
        blocks=[
            verdict(sentence, good=good),
            contents(title for title, _ in made),
            *(block for title, blocks in made for block in (heading(title), *blocks)),
        ],
    )


def _subtitle(found: Identification) -> str:
    names = [motion.name for motion in found.motions]
    more = [f"{len(names) - NAMED} more"] if len(names) > NAMED else []
    return f"from {listed([*names[:NAMED], *more])}" if names else ""


def _coefficients(found: Identification, before: Rig | None) -> list[str]:
    header = ["coefficient", "", "value", "standard error", "in % of the value", "95 % interval", "unit"]
    rows = [
        [*_estimate_row(found, name, estimate), *([] if before is None else [_before(name, estimate, found, before)])]
        for name, estimate in found.estimates.items()
    ]
    blocks = [table([*header, *([] if before is None else ["rig file before"])], rows)] if rows else []
    missing = findings.not_told(found)
    if missing:
        blocks += [
            paragraph("Not identifiable from these data:"),
            table(
                ["coefficient", "", "in the new rig file", "why it is not identifiable"],
                [
                    [
                        _named(found, entry.name),
                        findings.symbol(entry.name),
                        Entry(entry.value, heat=0.4),
                        entry.reason,
                    ]
                    for entry in missing
                ],
            ),
        ]
    return [*blocks, *map(paragraph, findings.other_remarks(found))]


def _named(found: Identification, name: str) -> Entry:
    return Entry(name, findings.meaning(found.rig, name))


def _estimate_row(found: Identification, name: str, estimate: Estimate) -> list[str | Entry]:
    text = findings.written(estimate.value, estimate.std)
    share = estimate.std / abs(estimate.value) if estimate.value else math.nan
    interval = MISSING_NUMBER if text.low == MISSING_NUMBER else f"{text.low} to {text.high}"
    beside = findings.readable(estimate, digits=2).split(" ±")[0] if estimate.unit in findings.READABLE else ""
    return [
        _named(found, name),
        findings.symbol(name),
        Entry(text.value, beside),
        text.error,
        findings.percent(share),
        interval,
        findings.unit_text(estimate.unit),
    ]


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
        return Entry(findings.as_shown(old))
    return Entry(findings.as_shown(old), f"{signed(100 * change, 2)} %" if abs(change) >= 1e-5 else "unchanged")


def _static(found: Identification) -> list[str]:
    curves = [drawn.stribeck(found), drawn.stribeck_slow(found)]
    residuals = [drawn.static_residuals(found)]
    return [figures(curves, columns=2), figures(residuals), left_out([*curves, *residuals])]


def _presliding(found: Identification) -> list[str]:
    panels = [drawn.hysteresis(found), *([drawn.branch(found)] if found.elements else [])]
    if found.branch is None or not found.nodes:
        return [figures(panels, columns=len(panels)), left_out(panels)]
    static_force = found.fit.friction.static_force
    rows: list[list[str | Entry]] = [
        [
            f"N{i}",
            f"{number(1e3 * node.way, 4)} mm",
            f"{number(node.force, 4)} N",
            f"{number(1e-3 * node.slope, 4)} N/mm",
            f"{number(1e-3 * stiffness, 4)} N/mm",
            number(0.5 * stiffness * node.way / static_force, 3),
        ]
        for i, (node, stiffness) in enumerate(zip(found.nodes, drawn.element_stiffness(found), strict=True), start=1)
    ]
    header = ["node", "travel", "force gained", "slope before it, Ki", "element stiffness, ki", "element weight, αi"]
    return [
        paragraph(findings.criteria_remark(found)),
        figures(panels, columns=2),
        left_out(panels),
        table(header, rows),
        paragraph(
            "The ramps end at 2 αi Fs, as at standstill. In motion friction is lower, and the branch bends a little earlier."
        ),
    ]


def _joint(found: Identification) -> list[str]:
    blocks = [paragraph(findings.noise_remark(found))] if findings.noise_remark(found) else []
    all_of_them = list(zip(found.motions, found.fit.residuals, found.fit.noise, strict=True))
    missing: list[Panel | LeftOut] = []
    for motion, residual, noise in all_of_them[:RECORDINGS]:
        excerpt = drawn.excerpt(motion, residual, noise)
        whole = [drawn.residual_over_time(motion, residual), drawn.residual_over_velocity(motion, residual)]
        blocks += [figures([excerpt]), figures(whole, columns=2)]
        missing.append(excerpt)
    missing += [
        LeftOut(f"Joint fit: {m.name}", f"only {RECORDINGS} recordings are drawn") for m, *_ in all_of_them[RECORDINGS:]
    ]
    return [*blocks, left_out(missing)]


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
    return [*([paragraph(remark)] if remark else []), table(["", *symbols], rows)]


def _correlation(value: float, *, same: bool) -> Entry:
    if same or not math.isfinite(value):
        return Entry("1" if same else MISSING_NUMBER)
    if abs(value) < NO_CORRELATION:
        return Entry("0")
    return Entry(f"{value:+.{2 if abs(value) < ALMOST_ONE else 4}f}".replace("-", "−"), heat=value)


def _search(found: Identification) -> list[str]:
    panels = [drawn.convergence(found)]
    return [figures(panels), left_out(panels)]


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
        ("Wall time", f"{number(found.wall_s)} s"),
    ]
    header = [
        "recording",
        "length",
        "block",
        "blocks",
        "counted",
        "outliers or missing",
        "noise of a block's force",
        "residual",
    ]
    rows = []
    for motion, residual, noise in zip(found.motions, fit.residuals, fit.noise, strict=True):
        counted = float(np.mean(np.isfinite(residual))) if len(residual) else 0.0
        rows.append(
            [
                motion.name,
                f"{number(len(motion.time) * motion.period, 4)} s",
                f"{findings.as_shown(1e3 * motion.period)} ms",
                number(len(motion.time)),
                f"{number(100 * counted, 2)} %",
                f"{number(100 * motion.outliers, 2)} %",
                f"{number(motion.force_noise)} N",
                f"{number(noise)} N",
            ]
        )
    return [
        paragraph(
            "Position and force are averaged over blocks; velocity and acceleration are derivatives of a local cubic. The joint"
            f" fit searched for {listed(list(fit.free)) if fit.free else 'nothing'} and solved for"
            f" {listed(list(fit.linear_names))}. Blocks with residuals that are too large are left out; correlated blocks count"
            " once."
        ),
        facts([(label, value) for label, value in items if value]),
        table(header, rows),
    ]
