"""Report of a whole rig's identification: coefficients, those not identifiable, and the reduction of the residuals."""

import math
from pathlib import Path

import numpy as np

from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.estimate import Estimate
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.physics.rig import Rig
from ehls_ros.report.identification_findings import as_shown, percent, unit_text, written
from ehls_ros.report.page import (
    MISSING_NUMBER,
    Entry,
    facts,
    listed,
    number,
    paragraph,
    sections,
    signed,
    table,
    verdict,
    write_page,
)

STRONG = 0.9
"""Correlation above which a pair is named."""

UNEXPLAINED = 3.0
"""Ratio of a residual to its noise above which the fitted model does not explain it."""

RESIDUALS = {
    "spool": "spool",
    "volume": "volume balance",
    "supply": "supply pressure",
    "force": "force balance",
    "cell": "load cell against load pressure",
    "velocity": "velocity against position",
}
"""Names of the residuals, by channel."""


def write_rig_report(found: RigIdentification, path: Path, *, before: Rig) -> None:
    """Write a self-contained HTML file that shows the identification of a whole rig.

    Args:
        found: the result.
        path: file to write; its folder must exist.
        before: the given rig file.
    """
    sentence, good = _sentence(found)
    parts = [
        ("Coefficients", _coefficients(found, before)),
        ("Not identifiable", _not_told(found, before)),
        ("Residuals", _residuals(found)),
        ("Correlations", _correlations(found)),
        ("How it was made", _making(found)),
    ]
    write_page(
        path,
        title="Rig identified",
        subtitle=f"from {listed(found.recordings)}",
        blocks=[verdict(sentence, good=good), *sections(parts)],
    )


def _sentence(found: RigIdentification) -> tuple[str, bool | None]:
    if not found.estimates:
        return "The recordings tell no coefficient of the rig.", None
    left = [
        RESIDUALS[name] for name, channel in found.channels.items() if channel.after > UNEXPLAINED * max(channel.noise, 1e-300)
    ]
    count = len(found.estimates)
    text = f"The recordings tell {count} coefficient{'s' if count > 1 else ''} of the rig"
    if left:
        return f"{text}; more than noise is left in {listed(left)}.", False
    return f"{text}, and little more than noise is left.", True


def _coefficients(found: RigIdentification, before: Rig) -> list[str]:
    header = ["coefficient", "value", "standard error", "in % of the value", "95 % interval", "unit", "rig file before"]
    rows = [_row(path, estimate, before) for path, estimate in found.estimates.items()]
    blocks = [table(header, rows)] if rows else []
    if found.absent:
        blocks += [
            paragraph("Looked for, and not told from none; the new rig file has none of it:"),
            table(["coefficient", "value", "standard error", "unit"], [_short(p, e) for p, e in found.absent.items()]),
        ]
    return [*blocks, *map(paragraph, found.remarks)]


def _row(path: str, estimate: Estimate, before: Rig) -> list[str | Entry]:
    text = written(estimate.value, estimate.std)
    old = read(before, path)
    change = estimate.value / old - 1.0 if old else math.nan
    beside = f"{signed(100.0 * change, 2)} %" if math.isfinite(change) else ""
    share = estimate.std / abs(estimate.value) if estimate.value else math.nan
    interval = MISSING_NUMBER if text.low == MISSING_NUMBER else f"{text.low} to {text.high}"
    return [path, text.value, text.error, percent(share), interval, unit_text(estimate.unit), Entry(as_shown(old), beside)]


def _short(path: str, estimate: Estimate) -> list[str | Entry]:
    text = written(estimate.value, estimate.std)
    return [path, text.value, text.error, unit_text(estimate.unit)]


def _not_told(found: RigIdentification, before: Rig) -> list[str]:
    rows: list[list[str | Entry]] = [
        [path, Entry(as_shown(read(before, path))), reason] for path, reason in found.not_identifiable.items()
    ]
    return [table(["coefficient", "in the rig file", "why"], rows)] if rows else []


def _residuals(found: RigIdentification) -> list[str]:
    rows = [
        [
            RESIDUALS[name],
            CHANNELS[name].replace("_", " "),
            percent(channel.before),
            percent(channel.after),
            percent(channel.noise),
        ]
        for name, channel in found.channels.items()
    ]
    header = ["residual", "stage", "rig file before", "fitted", "noise alone"]
    about = "Root mean square of measured minus modelled, as a fraction of the largest term of its balance."
    return [paragraph(about), table(header, rows)] if rows else []


def _correlations(found: RigIdentification) -> list[str]:
    names = list(found.estimates)
    pairs = [(float(found.correlations[i, j]), names[j], names[i]) for i in range(len(names)) for j in range(i)]
    strong = sorted((pair for pair in pairs if abs(pair[0]) >= STRONG), key=lambda pair: -abs(pair[0]))
    if not strong:
        return [paragraph(f"None reaches {STRONG:g} in size.")] if pairs else []
    rows: list[list[str | Entry]] = [
        [first, second, Entry(f"{value:+.3f}".replace("-", "−"), heat=value)] for value, first, second in strong
    ]
    return [table(["coefficient", "with", "correlation"], rows)]


def _making(found: RigIdentification) -> list[str]:
    items = [
        ("Recordings", number(len(found.recordings))),
        ("Coefficients fitted", number(len(found.estimates))),
        ("Friction model", found.rig.friction_model),
        ("Largest correlation", _largest(found)),
        ("Wall time", f"{number(found.wall_s)} s"),
    ]
    return [facts(items)]


def _largest(found: RigIdentification) -> str:
    if len(found.estimates) < 2:
        return MISSING_NUMBER
    return number(float(np.max(np.abs(found.correlations - np.eye(len(found.correlations))))), 2)
