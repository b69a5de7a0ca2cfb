"""Report of a whole rig's identification: coefficients, those not identifiable, and the reduction of the residuals."""

import math
from collections.abc import Callable
from pathlib import Path

from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.estimate import Estimate
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.physics.rig import Rig
from ehls_ros.progress import duration_text
from ehls_ros.report import page
from ehls_ros.report.identification_findings import STRONG, Pair, percent, relative_error, strong_pairs
from ehls_ros.report.page import MISSING_NUMBER, Entry, listed, number, paragraph, signed, table_of
from ehls_ros.report.quantities import as_shown, unit_text, written

UNEXPLAINED = 3.0
"""Ratio of a residual to its noise above which the fitted model does not explain it."""

RESIDUALS = {
    "spool": "spool",
    "volume": "volume balance",
    "volume_a": "volume balance of chamber A",
    "volume_b": "volume balance of chamber B",
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
        ("Not identifiable", _not_identified(found, before)),
        ("Residuals", _residuals(found)),
        ("Correlations", _correlations(found)),
        ("How it was made", _making(found)),
    ]
    blocks = [page.verdict(sentence, good=good), *page.sections(parts)]
    page.write_page(path, title="Rig identified", subtitle=f"from {listed(found.recordings)}", blocks=blocks)


def _sentence(found: RigIdentification) -> tuple[str, bool | None]:
    if not found.estimates:
        return "The recordings identify no coefficient of the rig.", None
    left = [
        RESIDUALS[name] for name, channel in found.channels.items() if channel.after > UNEXPLAINED * max(channel.noise, 1e-300)
    ]
    count = len(found.estimates)
    text = f"The recordings identify {count} coefficient{'s' if count > 1 else ''} of the rig"
    if left:
        return f"{text}; more than noise is left in {listed(left)}.", False
    return f"{text}, and little more than noise is left.", True


def _coefficients(found: RigIdentification, before: Rig) -> list[str]:
    rounded = {path: written(e.value, e.std) for path, e in (*found.estimates.items(), *found.absent.items())}
    short: dict[str, Callable[[tuple[str, Estimate]], str | Entry]] = {
        "coefficient": lambda item: item[0],
        "value": lambda item: rounded[item[0]].value,
        "standard error": lambda item: rounded[item[0]].error,
        "unit": lambda item: unit_text(item[1].unit),
    }
    columns = {
        **{title: short[title] for title in ("coefficient", "value", "standard error")},
        "in % of the value": lambda item: relative_error(item[1]),
        "95 % interval": lambda item: rounded[item[0]].interval,
        "unit": short["unit"],
        "rig file before": lambda item: _before(item[1].value, read(before, item[0])),
    }
    blocks = [table_of(found.estimates.items(), columns)]
    if found.absent:
        text = "Looked for, and not distinguishable from zero; the new rig file has none of it:"
        blocks += [paragraph(text), table_of(found.absent.items(), short)]
    return [*blocks, *map(paragraph, found.remarks)]


def _before(value: float, old: float) -> Entry:
    change = value / old - 1.0 if old else math.nan
    return Entry(as_shown(old), f"{signed(100.0 * change, 2)} %" if math.isfinite(change) else "")


def _not_identified(found: RigIdentification, before: Rig) -> list[str]:
    columns: dict[str, Callable[[tuple[str, str]], str | Entry]] = {
        "coefficient": lambda item: item[0],
        "in the rig file": lambda item: as_shown(read(before, item[0])),
        "why": lambda item: item[1],
    }
    return [table_of(found.not_identifiable.items(), columns)]


def _residuals(found: RigIdentification) -> list[str]:
    rows = table_of(
        found.channels.items(),
        {
            "residual": lambda item: RESIDUALS[item[0]],
            "stage": lambda item: CHANNELS[item[0]].replace("_", " "),
            "rig file before": lambda item: percent(item[1].before),
            "fitted": lambda item: percent(item[1].after),
            "noise alone": lambda item: percent(item[1].noise),
        },
    )
    about = "Root mean square of measured minus modelled, as a fraction of the largest term of its balance."
    return [paragraph(about), rows] if rows else []


def _correlations(found: RigIdentification) -> list[str]:
    strong, largest = strong_pairs(list(found.estimates), found.correlations)
    if not strong:
        return [paragraph(f"None reaches {STRONG:g} in size.")] if largest else []
    columns: dict[str, Callable[[Pair], str | Entry]] = {
        "coefficient": lambda pair: pair.first,
        "with": lambda pair: pair.second,
        "correlation": lambda pair: Entry(f"{pair.correlation:+.3f}".replace("-", "−"), heat=pair.correlation),
    }
    return [table_of(strong, columns)]


def _making(found: RigIdentification) -> list[str]:
    _, largest = strong_pairs(list(found.estimates), found.correlations)
    items = [
        ("Recordings", number(len(found.recordings))),
        ("Coefficients fitted", number(len(found.estimates))),
        ("Friction model", found.rig.friction_model),
        ("Largest correlation", number(abs(largest.correlation), 2) if largest else MISSING_NUMBER),
        ("Wall time", duration_text(found.wall_s)),
    ]
    return [page.facts(items)]
