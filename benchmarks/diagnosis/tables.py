"""The tables of a run."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.diagnosis.cases import EXPERIMENTS, KINDS
from benchmarks.diagnosis.exams import EXAMS
from benchmarks.diagnosis.judge import Judgement, below_power, closed_off, judge, peer_right, strength
from benchmarks.rows import Row

BINS = (0.0, 1.3, 2.0, 4.0, 8.0, 16.0, 32.0, 100.0, np.inf)
"""Bin edges of the visibility."""

BELIEFS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Bin edges of the probability of a named cause."""

Judged = list[tuple[Row, Judgement]]


def show(rows: Sequence[Row], console: Console) -> None:
    """Print all tables of some rows, exam by exam."""
    for exam in EXAMS:
        of_exam = [row for row in rows if row.get("exam", "clean") == exam]
        if of_exam:
            _show(exam, of_exam, console)


def _show(exam: str, rows: Sequence[Row], console: Console) -> None:
    judged = [(row, judge(row)) for row in sorted(rows, key=lambda row: row["number"])]
    of = {kind: [(r, j) for r, j in judged if r["kind"] == kind] for kind in KINDS}
    sources = sorted({row["sources"] for row in rows})
    seeds = ", ".join(sorted({str(r["seed"]) for r in rows}))
    console.print(f"exam {exam}: {len(rows)} cases, seed {seeds}, sources {', '.join(sources)}")
    if len(sources) > 1:
        console.print("[bold]The package changed between these cases: run into a new file for numbers to publish.[/bold]")
    redrawn = sum(r.get("redrawn", 0) for r in rows)
    hopeless = sum(1 for r in rows if r.get("hidden") and strength(r) < BINS[1])
    console.print(
        f"draws repeated because an effect would not have shown: {redrawn}; cases that still do not show: {hopeless}\n"
    )
    console.print(headline(judged, of) if exam not in MARKS else hard_headline(exam, judged, of))
    peers = peer_table(of)
    if peers is not None:
        console.print(peers)
    console.print(by_visibility(of))
    console.print(by_experiment(judged))
    if any(r.get("data") for r in rows):
        console.print(by_data(judged))
    console.print(by_effect(judged))
    if sides := [side for _, j in judged for side in j.sides]:
        console.print(f"side right, of rightly named effects with one: {share(sides)}\n")
    console.print(reliability(judged))
    console.print(confusions(judged))
    console.print(not_there(judged))
    console.print(failures(judged))


def share(values: Sequence[bool]) -> str:
    """Return a percentage with its counts."""
    return f"{100.0 * sum(values) / len(values):.1f} % ({sum(values)}/{len(values)})" if values else "–"


def _mark(values: Sequence[bool], least: float | None = None, most: float | None = None) -> str:
    if not values or (least is None and most is None):
        return ""
    rate = sum(values) / len(values)
    return _verdict((least is None or rate >= least) and (most is None or rate <= most))


def _verdict(good: bool) -> str:
    return "[green]met[/green]" if good else "[red]missed[/red]"


MARKS: dict[str, tuple[float, float | None, float | None]] = {
    "partial": (0.9, 0.02, 0.02), "baseline": (0.95, None, None), "skew": (0.96, None, None),
    "forms": (0.94, None, None),
    "raw": (0.9, None, None), "neighbours": (0.9, None, None), "single_rod partial": (0.9, 0.02, 0.02),
    "single_rod baseline": (0.95, None, None), "single_rod one_pressure": (0.9, None, None),
}  # fmt: skip
"""By exam: minimum share of right names, maximum of confident wrong ones, maximum of absent causes named beside a true one."""


def hard_headline(exam: str, judged: Judged, of: dict[str, Judged]) -> Table:
    """Return the results of an exam other than the clean one against its targets."""
    least, confident, beside = MARKS[exam]
    table = Table(title="against the marks", title_justify="left")
    for column in ("", "mark", "", ""):
        table.add_column(column, justify="left")

    def row(what: str, values: list[bool], at_least: float | None = None, at_most: float | None = None) -> None:
        mark = f"≥ {100 * at_least:g} %" if at_least is not None else f"≤ {100 * at_most:g} %" if at_most is not None else ""
        table.add_row(what, mark, share(values), _mark(values, at_least, at_most))

    single, pair, nothing = of["singles"], of["pairs"], of["nothing"]
    row("right cause first, no other that is not there", [j.right for _, j in single], least)
    row("  right cause first, whatever is named beside it", [j.first for _, j in single])
    row("  or rightly said to be too small to be seen", [j.right or below_power(r) for r, j in single])
    row("a true cause and one that is not there", [bool(j.not_there) for _, j in single], None, beside)
    if pair:
        row("pair: both named, no other", [j.right for _, j in pair], 0.9)
        row("  both named, whatever is named beside them", [j.first for _, j in pair])
        row("  or the other rightly said to be too small to be seen", [j.right or below_power(r) for r, j in pair])
    row("confident wrong name", [j.confident_wrong for _, j in judged], None, confident)
    if nothing:
        row("nothing hidden: false alarms", [not j.lenient for _, j in nothing], None, 0.01)
        row("  not judged, with the reason", [j.lenient and not j.right for _, j in nothing])
    for verdict in ("consistent", "unknown", "insufficient", "partial", "effect"):
        row(f"  verdict {verdict}, with something hidden", [r.get("ours", {}).get("verdict") == verdict for r, _ in single])
    off = [value for r, _ in single if (value := closed_off(r)) is not None]
    if off:
        sizes = np.abs(off)
        table.add_row("closed share off the true one: median, 90th percentile", "", " ".join(
            f"{100 * value:.1f} points" for value in np.quantile(sizes, [0.5, 0.9])))  # fmt: skip
        row("  within 10 points", [bool(value <= 0.1) for value in sizes])
        named = [r for r, _ in single if closed_off(r) is not None]
        row("  its 95 % interval holds the true one", [_holds(r["ours"]["gain"]["ci95"], r["share"]) for r in named])
    quantities = [q for _, j in single for q in j.quantities]
    if quantities:
        covered = [q.covered for q in quantities]
        rate = sum(covered) / len(covered)
        table.add_row("95 % intervals that hold the truth", "88–99 %", share(covered), _verdict(0.88 <= rate <= 0.99))
        errors = np.abs([q.error for q in quantities])
        table.add_row("parameters, |error| / size of the effect: median", "", f"{100 * float(np.median(errors)):.2f} %")
    row("went wrong (exception)", [j.what == "error" for _, j in judged], None, 0.0)
    walls = [r["ours"]["wall_s"] for r, _ in judged if "ours" in r]
    if walls:
        table.add_row("time, one thread: median, worst", "", f"{np.median(walls):.1f} s, {max(walls):.1f} s")
    return table


def _holds(interval: Sequence[float], value: float) -> bool:
    low, high = interval
    return bool(low <= value <= high)


def headline(judged: Judged, of: dict[str, Judged]) -> Table:
    """Return the results against the targets."""
    table = Table(title="against the marks", title_justify="left")
    for column in ("", "mark", "strict", "", "lenient"):
        table.add_column(column, justify="left")

    def row(what: str, mark: str, strict: list[bool], lenient: list[bool], least: float | None, most: float | None) -> None:
        table.add_row(what, mark, share(strict), _mark(strict, least, most), share(lenient))

    single, pair, nothing, outside = (of[kind] for kind in KINDS)
    right, lenient = [j.right for _, j in single], [j.lenient for _, j in single]
    row("single: right cause first, no other that is not there", "≥ 95 %", right, lenient, 0.95, None)
    row("  right cause first, whatever is named beside it", "", [j.first for _, j in single], [], None, None)
    row("  by its own name, nothing beside it", "", [j.exact for _, j in single], [], None, None)
    row("pair: both named, no other", "≥ 85 %", [j.right for _, j in pair], [j.lenient for _, j in pair], 0.85, None)
    row("  right causes, whatever is named beside them", "", [j.first for _, j in pair], [], None, None)
    row("  by their own names, nothing beside them", "", [j.exact for _, j in pair], [], None, None)
    for kind, cases in (("single", single), ("pair", pair)):
        beside = [bool(j.not_there) for _, j in cases]
        row(f"{kind}: a true cause and one that is not there", "", beside, [], None, None)
    alarms = [not j.right for _, j in nothing]
    row("nothing hidden: false alarms", "≤ 1 %", alarms, alarms, None, 0.01)
    offered = [bool(r.get("ours", {}).get("term")) for r, _ in single + pair + nothing]
    row("nothing outside the list: a term offered", "≤ 1 %", offered, offered, None, 0.01)
    right, lenient = [j.right for _, j in outside], [j.lenient for _, j in outside]
    row("outside the list: unexplained in the right stage, nothing for certain", "≥ 90 %", right, lenient, 0.9, None)
    unknown = [r.get("ours", {}).get("verdict") == "unknown" for r, _ in outside]
    row("  unknown, whatever stage", "", unknown, [], None, None)
    wrong = [j.confident_wrong for _, j in outside]
    row("outside: confident wrong name", "≤ 3 %", wrong, [j.confident_wrong_lenient for _, j in outside], None, 0.03)
    wrong, lenient = [j.confident_wrong for _, j in judged], [j.confident_wrong_lenient for _, j in judged]
    row("confident wrong name, all cases", "", wrong, lenient, None, None)
    row("insufficient", "", [j.what == "insufficient" for _, j in judged], [], None, None)
    row("went wrong (exception)", "0", [j.what == "error" for _, j in judged], [], None, 0.0)
    quantities = [q for r, j in single + pair for q in j.quantities]
    if quantities:
        errors = np.abs([q.error for q in quantities])
        middle = float(np.median(errors))
        lone = [float(np.median([abs(q.error) for q in j.quantities])) for _, j in single if j.quantities]
        table.add_row(
            "parameters, |error| / size of the effect: median", "≤ 3 %", f"{100 * middle:.2f} % ({errors.size})",
            _verdict(middle <= 0.03), f"{100 * float(np.median(lone)):.2f} % singles" if lone else "",
        )  # fmt: skip
        table.add_row("  quartile, 90th percentile", "", " ".join(f"{100 * v:.1f} %" for v in np.quantile(errors, [0.75, 0.9])))
        covered = [q.covered for q in quantities]
        row("  95 % intervals that hold the truth", "88–99 %", covered, [], 0.88, 0.99)
    # A recording that is rightly refused has no answer.
    answered = [r["ours"] for r, j in single + pair if j.right and "ours" in r]
    closed = [ours["gain"]["closed_fraction"] for ours in answered if ours["gain"]]
    if closed:
        middle = float(np.median(closed))
        least = f"least {100 * min(closed):.0f} %"
        table.add_row("closed fraction, median", "≥ 90 %", f"{100 * middle:.1f} %", _verdict(middle >= 0.9), least)
    walls = [r["ours"]["wall_s"] for r, _ in judged if "ours" in r]
    if walls:
        table.add_row("time, one thread: median, worst", "", f"{np.median(walls):.1f} s, {max(walls):.1f} s")
    return table


def peer_table(of: dict[str, Judged]) -> Table | None:
    """Return the comparison with the peers on the same cases; None if they did not run."""
    names = list(dict.fromkeys(name for js in of.values() for r, _ in js for name in r.get("peers", {})))
    if not names:
        return None
    table = Table(title="peers on the same cases", title_justify="left")
    for column in ("", "singles, first named", "pairs, both named", "false alarms", "outside: names something", "time, median"):
        table.add_column(column)
    same = {kind: [(r, j) for r, j in js if "peers" in r] for kind, js in of.items()}
    ours = [r["ours"]["wall_s"] for js in same.values() for r, _ in js]
    table.add_row(
        "ours", share([j.right for _, j in same["singles"]]), share([j.right for _, j in same["pairs"]]),
        share([not j.right for _, j in same["nothing"]]),
        share([r["ours"]["verdict"] == "effect" for r, _ in same["outside"]]), f"{np.median(ours):.1f} s",
    )  # fmt: skip
    for name in names:
        right = {
            kind: [peer_right(r, r["peers"][name]["named"]) for r, _ in js if name in r["peers"]] for kind, js in same.items()
        }
        walls = [r["peers"][name]["wall_s"] for js in same.values() for r, _ in js if name in r["peers"]]
        table.add_row(
            name, share(right["singles"]), share(right["pairs"]), share([not v for v in right["nothing"]]),
            share([bool(r["peers"][name]["named"]) for r, _ in same["outside"]]), f"{np.median(walls):.1f} s",
        )  # fmt: skip
    return table


def by_visibility(of: dict[str, Judged]) -> Table:
    """Return the frequency of detection and of correct naming, by visibility."""
    table = Table(title="against how far the (weaker) effect stands out of the noise", title_justify="left")
    for column in ("visibility", "singles noticed", "right", "pairs right", "outside noticed", "right"):
        table.add_column(column)
    for low, high in pairwise(BINS):
        cells: list[str] = []
        for kind in ("singles", "pairs", "outside"):
            inside = [(r, j) for r, j in of[kind] if "visibility" in r and low <= strength(r) < high]
            if kind != "pairs":
                cells.append(share([j.what != "consistent" for _, j in inside]))
            cells.append(share([j.right for _, j in inside]))
        if any(cell != "–" for cell in cells):
            table.add_row(f"{low:g} to {high:g}", *cells)
    return table


def by_experiment(judged: Judged) -> Table:
    """Return the success rate of the diagnosis, by experiment."""
    table = Table(title="by experiment", title_justify="left")
    for column in ("", *KINDS):
        table.add_column(column)
    for experiment in EXPERIMENTS:
        here = [(r, j) for r, j in judged if r.get("experiment") == experiment]
        table.add_row(experiment, *(share([j.right for r, j in here if r["kind"] == kind]) for kind in KINDS))
    return table


def by_data(judged: Judged) -> Table:
    """Return the success rate of the diagnosis and the number of effects it leaves open, by the kind of data."""
    table = Table(title="by kind of data", title_justify="left")
    for column in ("", "right", "by its own name", "equivalent_to, mean number"):
        table.add_column(column)
    for data in dict.fromkeys(r.get("data", "") for r, _ in judged):
        here = [(r, j) for r, j in judged if r.get("data", "") == data]
        open_ = [len(r["ours"]["causes"][0]["equivalent_to"]) for r, j in here if j.right]
        others = f"{np.mean(open_):.1f}" if open_ else "–"
        table.add_row(data, share([j.right for _, j in here]), share([j.exact for _, j in here]), others)
    return table


def by_effect(judged: Judged) -> Table:
    """Return a line for every effect."""
    table = Table(title="by effect", title_justify="left")
    for column in ("hidden", "alone", "in pairs, pair right", "in pairs, itself named", "|error|, median", "intervals hold"):
        table.add_column(column)
    rows: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    for r, j in judged:
        for name in r.get("hidden", {}):
            if r["kind"] == "pairs":
                named = {n for c in r.get("ours", {}).get("causes", ()) for n in (c["name"], *c["equivalent_to"])}
                rows[name]["pair"].append(j.right)
                rows[name]["named"].append(name in named)
            else:
                rows[name]["alone"].append(j.right)
            rows[name]["quantities"] += j.quantities if r["kind"] == "singles" else []
    for name in sorted(rows):
        cells, quantities = rows[name], rows[name]["quantities"]
        error = f"{100 * float(np.median([abs(q.error) for q in quantities])):.2f} %" if quantities else "–"
        table.add_row(
            name, *(share(cells[k]) for k in ("alone", "pair", "named")), error, share([q.covered for q in quantities])
        )
    return table


def reliability(judged: Judged) -> Table:
    """Return how often a cause named with a probability is hidden indeed; an effect outside the list is never named rightly."""
    table = Table(title="named with a probability of", title_justify="left")
    for column in ("from", "to", "mean", "hidden indeed"):
        table.add_column(column)
    beliefs = [belief for _, j in judged for belief in j.beliefs]
    for low, high in pairwise(BELIEFS):
        inside = [(p, true) for p, true in beliefs if low < p <= high]
        mean = f"{100.0 * float(np.mean([p for p, _ in inside])):.1f} %" if inside else "–"
        table.add_row(f"{100.0 * low:g} %", f"{100.0 * high:g} %", mean, share([true for _, true in inside]))
    return table


def confusions(judged: Judged) -> Table:
    """Return the confusions between causes, wrong cases only."""
    table = Table(title="taken for something else", title_justify="left")
    for column in ("hidden", "said", "times"):
        table.add_column(column)
    counts = Counter((" + ".join(r.get("hidden", {})) or "nothing", j.what) for r, j in judged if not j.right)
    for (hidden, said), count in counts.most_common():
        table.add_row(hidden, said, str(count))
    return table


def not_there(judged: Judged) -> Table:
    """Return the cases in which a true cause is named together with an absent one."""
    table = Table(title="a true cause named with one that is not there", title_justify="left")
    for column in ("case", "experiment", "hidden (visibility by stage)", "not there", "detail"):
        table.add_column(column, overflow="fold")
    for r, j in judged:
        if j.not_there:
            table.add_row(
                f"{r['seed']}:{r['number']}", r.get("experiment", "?"), hidden_text(r), " + ".join(j.not_there), detail(r)
            )
    return table


def failures(judged: Judged) -> Table:
    """Return every case that is not right."""
    table = Table(title="every case that is not right (* lenient judge lets it pass)", title_justify="left")
    for column in ("case", "experiment", "hidden (visibility by stage)", "said", "detail"):
        table.add_column(column, overflow="fold")
    for r, j in judged:
        if not j.right:
            table.add_row(
                f"{r['seed']}:{r['number']}{'*' if j.lenient else ''}",
                f"{r.get('experiment', '?')} {r.get('record_seed', '')}", hidden_text(r), j.what, detail(r),
            )  # fmt: skip
    return table


def hidden_text(r: Row) -> str:
    """Return the hidden effects, their sizes and the stages in which they show."""
    parts = []
    for name, sizes in r.get("hidden", {}).items():
        given = ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in sizes.items())
        seen = ", ".join(f"{stage} {value:.3g}" for stage, value in r["visibility"][name].items() if value >= BINS[1] / 2)
        parts.append(f"{name}: {given} ({seen})")
    if r.get("forms"):
        sizes = ", ".join(f"{stage} {100 * size:.2g} %" for stage, size in r["forms"]["sizes"].items())
        parts.append(f"form errors {sizes}")
    return "; ".join(parts) or "nothing"


def detail(r: Row) -> str:
    """Return the details of a failed case."""
    if "ours" not in r:
        return str(r.get("refused") or r.get("error", "")).strip().splitlines()[-1]
    ours, parts = r["ours"], []
    for c in ours["causes"]:
        values = ", ".join(f"{k} {v:.3g}±{s:.1g}" for k, (v, s) in c["parameters"].items())
        rivals = ", ".join(f"{x['name']} -{x['behind']:.0f}" for x in c["rivals"][:3])
        parts.append(f"{c['name']} p={c['probability']:.2f} gain {c['gain']:.0f} ({values}) before {rivals}")
    for stage, s in ours["stages"].items():
        if s["judged"] and (s["exceeds"] or s["unexplained"]):
            left = "left" if s["unexplained"] else "mended"
            parts.append(f"{stage} {left}: {s['nrmse_before']:.1e} → {s['nrmse_after']:.1e}, noise {s['noise_floor']:.1e}")
    if ours["gain"] is not None:
        parts.append(f"closed {100 * ours['gain']['closed_fraction']:.0f} %")
    return "; ".join(parts)
