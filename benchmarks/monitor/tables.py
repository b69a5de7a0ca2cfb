"""The tables of the benchmark."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import scipy.stats
from rich.console import Console
from rich.table import Table

from benchmarks.monitor.healthy import SETTINGS
from benchmarks.monitor.judge import Judged, judge
from benchmarks.rows import Row
from ehls_ros.diagnosis.monitoring.change_test import lengths

TAIL = (4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0)
"""Sums, in standard deviations, whose frequency is compared with theory."""

LONG = 1e3
"""Hours whose running time is projected."""


def rate(count: int, hours: float) -> tuple[float, float, float]:
    """Return a rate of events with its exact 95 % interval (Garwood), an hour."""
    if hours <= 0.0:
        return float("nan"), float("nan"), float("nan")
    low = 0.5 * scipy.stats.chi2.ppf(0.025, 2 * count) if count else 0.0
    return count / hours, float(low) / hours, 0.5 * float(scipy.stats.chi2.ppf(0.975, 2 * count + 2)) / hours


def _rate(count: int, hours: float) -> str:
    middle, low, high = rate(count, hours)
    return f"{count}: {middle:.2g}/h [{low:.2g}, {high:.2g}]"


def incidents(largest: Sequence[float], bound: float) -> int:
    """Return how often the largest sum of a block rises above a bound."""
    above = np.asarray(largest) > bound
    return int(np.sum(above[1:] & ~above[:-1])) + int(bool(len(above)) and bool(above[0]))


def line_of(row: Row) -> str:
    """Return an episode or a case in one line."""
    if "error" in row:
        return f"{row['number']:4d} ERROR {row['error'].strip().splitlines()[-1]}"
    if "largest" in row:
        kinds = ", ".join(f"{e['kind']} at {e['time']:.0f} s ({e['text']})" for e in row["events"] if e["kind"] not in _USUAL)
        most = max(row["largest"], default=0.0)
        took = f"{row['watched_h']:.2f} h in {row['processor_s']:.0f} s of a processor"
        return f"{row['number']:4d} {row['kind']} {took}, largest {most:.1f}; {kinds}"
    j = judge(row)
    return f"{row['number']:4d} {'ok   ' if j.right else 'WRONG' if j.counts else '-    '} {row['effect']}: {j.words}"


_USUAL = ("learnt", "watching", "differs")


def show_healthy(rows: Sequence[Row], console: Console) -> None:
    """Print the false alarm rate of a healthy rig."""
    good = [row for row in rows if "error" not in row]
    kinds = {kind: [row for row in good if row["kind"] == kind] for kind in dict.fromkeys(row["kind"] for row in good)}
    table = Table(title="false alarms, with the exact 95 % interval of the rate", title_justify="left")
    names = [f"noticed at {hours:g} h" for hours in SETTINGS]
    for column in ("rig", "hours", *names, f"named at {SETTINGS[0]:g} h", "not confirmed", "differs from its file"):
        table.add_column(column)
    for kind, of in {**kinds, "all": good}.items():
        hours = sum(row["watched_h"] for row in of)
        noticed = [
            sum(incidents(row["largest"], row["bounds"][place]) for row in of if row["bounds"])
            for place in range(len(SETTINGS))
        ]
        events = [event["kind"] for row in of for event in row["events"]]
        table.add_row(
            kind, f"{hours:.1f}", *(_rate(count, hours) for count in noticed), _rate(events.count("named"), hours),
            _rate(events.count("unconfirmed"), hours), f"{events.count('differs')} of {len(of)}",
        )  # fmt: skip
    console.print(table)
    _show_tail(good, console)
    took, hours = sum(row["processor_s"] for row in good), sum(row["watched_h"] for row in good)
    if took:
        speed = 3600.0 * hours / sum(row["monitor_s"] for row in good)
        ahead = LONG * took / max(hours, 1e-9) / 3600.0
        both = f"with the streams {took / 60.0:.0f} min of a processor; {LONG:g} h take {ahead:.0f} h of one"
        console.print(f"the monitor {speed:.0f} × real time, {both}")
    errors = [row for row in rows if "error" in row]
    for row in errors:
        console.print(f"episode {row['number']} went wrong: {row['error'].strip().splitlines()[-1]}")


def _show_tail(rows: Sequence[Row], console: Console) -> None:
    title = "largest sum of a block: blocks above a size, against chance for all sums together"
    table = Table(title=title, title_justify="left")
    for column in ("standard deviations", "blocks", "at most by chance (Bonferroni)"):
        table.add_column(column)
    blocks = np.array([value for row in rows for value in row["largest"]])
    sums = [(row["quantities"], len(row["largest"])) for row in rows]
    for size in TAIL:
        expected = sum(2.0 * count * len(lengths()) * scipy.stats.norm.sf(size) * n for count, n in sums)
        table.add_row(f"{size:g}", f"{int(np.sum(blocks > size))} of {blocks.size}", f"{expected:.3g}")
    console.print(table)


def show_hidden(rows: Sequence[Row], console: Console) -> None:
    """Print the correctness and the delay of the names of effects that begin while the rig runs."""
    good = [row for row in rows if "error" not in row]
    judged = [(row, judge(row)) for row in good]
    counted = [(row, j) for row, j in judged if j.counts]
    table = Table(title="effects that begin or grow while the rig runs", title_justify="left")
    for column in ("", "value"):
        table.add_column(column)
    table.add_row("cases, found by an offline diagnosis of 60 s", f"{len(counted)} of {len(good)}")
    table.add_row("noticed", _share([j.noticed is not None for _, j in counted]))
    table.add_row("right name first (mark: ≥ 90 %)", _share([j.right for _, j in counted]))
    table.add_row("wrong name first", _share([j.named is not None and not j.right for _, j in counted]))
    table.add_row("alarm before the onset", str(sum(j.early for _, j in judged)))
    right = [j for _, j in counted if j.right]
    table.add_row("onset to noticed", quartiles([j.noticed for j in right]))
    table.add_row("onset to name", quartiles([j.named for j in right]))
    table.add_row("shortest stretch that an offline diagnosis names", quartiles([j.bound for j in right]))
    table.add_row("delay beyond it (mark: median ≤ 10 s)", quartiles([j.beyond for j in right]))
    table.add_row("  with the time the diagnoses took", quartiles([j.beyond_with_wall for j in right]))
    shares = [row["share"] for row, j in counted if j.right and "share" in row]
    if shares:
        table.add_row("part of its final size when named", quartiles(shares, ""))
    console.print(table)
    _show_effects(counted, console)
    for row in rows:
        if "error" in row:
            console.print(f"case {row['number']} went wrong: {row['error'].strip().splitlines()[-1]}")


def _show_effects(counted: Sequence[tuple[Row, Judged]], console: Console) -> None:
    table = Table(title="by effect", title_justify="left")
    for column in ("effect", "right", "what was said", "noticed, s", "named, s", "bound, s"):
        table.add_column(column)
    of: dict[str, list[Judged]] = defaultdict(list)
    for row, j in counted:
        of[row["effect"]].append(j)
    for effect, judged in sorted(of.items()):
        times = ([getattr(j, what) for j in judged] for what in ("noticed", "named", "bound"))
        cells = (", ".join("–" if t is None else f"{t:.1f}" for t in values) for values in times)
        table.add_row(effect, f"{sum(j.right for j in judged)}/{len(judged)}", "; ".join(j.words for j in judged), *cells)
    console.print(table)


def _share(values: Sequence[bool]) -> str:
    if not values:
        return "–"
    low, high = scipy.stats.binomtest(sum(values), len(values)).proportion_ci(method="wilson")
    return f"{100 * np.mean(values):.0f} % ({sum(values)} of {len(values)}) [{100 * low:.0f}, {100 * high:.0f}]"


def quartiles(values: Sequence[float | None], unit: str = " s") -> str:
    """Return median, quartiles and number of the known values as text."""
    there = [value for value in values if value is not None]
    if not there:
        return "–"
    low, middle, high = np.quantile(there, [0.25, 0.5, 0.75])
    return f"{middle:.3g}{unit} [{low:.3g}, {high:.3g}] ({len(there)})"
