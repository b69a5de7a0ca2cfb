"""The tables of the strangers."""

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import Quantity
from benchmarks.rows import Row
from benchmarks.strangers.judge import INTERVAL, absolutes, judge, reading, unchanged
from benchmarks.strangers.running import MODES


def show(rows: Sequence[Row], console: Console) -> None:
    """Print all tables."""
    rows = sorted(rows, key=lambda row: row["number"])
    good = [row for row in rows if "error" not in row]
    hidden = sum(bool(row["kind"]) for row in good)
    console.print(
        f"{len(rows)} strangers, {hidden} with a hidden change, sources {', '.join(sorted({r['sources'] for r in rows}))}"
    )
    console.print(_modes(good))
    console.print(_values(good))
    console.print(_cases(good))
    for row in rows:
        for where in ("", *MODES):
            given = row.get(where, {}) if where else row
            if "error" in given:
                console.print(f"stranger {row['number']} {where}: {given['error'].strip().splitlines()[-1]}", markup=False)


def _modes(rows: Sequence[Row]) -> Table:
    table = Table(title="hidden changes", title_justify="left")
    heads = (
        "mode",
        "name right",
        "of the visible",
        "missed",
        "wrong",
        "false alarms",
        "sizes",
        "relative error, median (90 %)",
    )
    for head in (*heads, "in the 95 % interval", "time, median"):
        table.add_column(head)
    for mode in MODES:
        judged = [(row, j) for row in rows if (j := judge(row, mode)) is not None]
        of = [j for row, j in judged if row["kind"]]
        healthy = [j for row, j in judged if not row["kind"]]
        visible = [j.verdict == "right" for j in of if j.visible]
        counts = [sum(j.verdict == verdict for j in of) for verdict in ("right", "missed", "wrong")]
        sizes = [j.size for j in of if j.size is not None]
        walls = [row["wall_s"][mode] for row, _ in judged]
        alarms = sum(j.verdict == "false alarm" for j in healthy)
        table.add_row(
            mode, f"{counts[0]} of {len(of)}", f"{sum(visible)} of {len(visible)}" if visible else "–", str(counts[1]),
            str(counts[2]), f"{alarms} of {len(healthy)}", f"{len(sizes)} of {len(of)}",
            _errors(sizes), _coverage(sizes), f"{np.median(walls):.0f} s" if walls else "–",
        )  # fmt: skip
    readings = [size for row in rows if (size := reading(row)) is not None]
    table.add_row("monitor's table", "", "", "", "", "", str(len(readings)), _errors(readings), _coverage(readings), "")
    return table


def _errors(sizes: Sequence[Quantity]) -> str:
    if not sizes:
        return "–"
    errors = 100.0 * np.abs([size.error for size in sizes])
    return f"{np.median(errors):.2g} % ({np.quantile(errors, 0.9):.2g} %)"


def _coverage(sizes: Sequence[Quantity]) -> str:
    if not sizes:
        return "–"
    inside = sum(size.sigmas <= INTERVAL for size in sizes)
    return f"{100.0 * inside / len(sizes):.0f} % ({inside} of {len(sizes)})"


def _values(rows: Sequence[Row]) -> Table:
    table = Table(title="values against the truth, and coefficients that did not change", title_justify="left")
    for head in ("source", "coefficient", "values", "relative error, median (90 %)", "in the 95 % interval"):
        table.add_column(head)
    found = [entry for row in rows for entry in absolutes(row)]
    for source, name in sorted({entry[:2] for entry in found}):
        sizes = [size for s, n, size in found if (s, n) == (source, name)]
        table.add_row(source, name, str(len(sizes)), _errors(sizes), _coverage(sizes))
    same = [entry for row in rows for entry in unchanged(row)]
    for path in (*sorted({path for path, _ in same}), ""):
        sigmas = np.abs([s for p, s in same if path in ("", p)])
        if sigmas.size:
            inside = f"{100.0 * np.mean(sigmas <= INTERVAL):.0f} % ({np.sum(sigmas <= INTERVAL)} of {sigmas.size})"
            table.add_row(
                "identify, unchanged", path or "all", str(sigmas.size), "", f"{inside}, largest {np.max(sigmas):.1f} σ"
            )
    return table


def _cases(rows: Sequence[Row]) -> Table:
    table = Table(title="case by case: told ± standard error", title_justify="left")
    for head in ("number", "hidden", "true", *MODES, "monitor's table"):
        table.add_column(head, overflow="fold")
    for row in rows:
        cells = []
        for mode in MODES:
            j = judge(row, mode)
            if j is None:
                cells.append("–")
                continue
            size = j.why_not if j.size is None else _size(j.size)
            visible = {None: "", True: "", False: ", below its power"}[j.visible]
            cells.append(f"{j.verdict}{visible}: {size}; {j.words}" if j.verdict != "quiet" else "quiet")
        told = reading(row)
        cells.append("–" if told is None else _size(told))
        table.add_row(str(row["number"]), row["kind"] or "nothing", f"{row['size']:.4g}", *cells)
    return table


def _size(size: Quantity) -> str:
    return f"{size.value:.4g} ± {size.std:.2g} ({100 * size.error:+.1f} %, {size.sigmas:.1f} σ)"


def line_of(row: Row) -> str:
    """Return a stranger in one line."""
    if "error" in row:
        return f"{row['number']:4d} ERROR {row['error'].strip().splitlines()[-1]}"
    told = []
    for mode in MODES:
        j = judge(row, mode)
        if j is not None:
            told.append(
                f"{mode} {j.verdict}" + (f" {100 * j.size.error:+.1f} %" if j.size else "") + f" {row['wall_s'][mode]:.0f} s"
            )
    return f"{row['number']:4d} {row['kind'] or 'nothing'} {row['size']:.3g}: {'; '.join(told)}"
