"""The report of a campaign: how the errors of its runs are spread, and what they go with."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros.report import campaign_figures as drawn
from ehls_ros.report import campaign_findings as findings
from ehls_ros.report.campaign_findings import CONVERGENCE, ERROR, Column, Group, Results, numbers
from ehls_ros.report.page import (
    Entry,
    as_yaml,
    collapsed,
    contents,
    facts,
    figures,
    heading,
    number,
    paragraph,
    table,
    verdict,
    write_page,
)

MOST_GROUPS, MOST_ROWS, MOST_COLUMNS = 8, 10, 6
"""Groups in one figure, rows of the tables of single runs, varied columns in them."""

SEED = "seed"
"""A column that is drawn and yet no parameter."""


def write_campaign_report(
    results: Results, columns: Sequence[Column], campaign: Mapping[str, Any], making: Sequence[tuple[str, str]], path: Path
) -> None:
    """Write one HTML file that shows the campaign and needs nothing else.

    Args:
        results: the table's columns by name.
        columns: the varied paths.
        campaign: the campaign's file, its base written out.
        making: label and value of how it was made.
        path: file to write; its folder must exist.
    """
    groups = findings.groups(results, columns)
    known = bool(np.isfinite(numbers(results, ERROR)).any())
    parts = {
        "Groups": [_group_table(results, groups)],
        "Sweeps": _sweeps(results, columns, groups) if known else [],
        "Draws": _draws(results, columns, groups) if known else [],
        "Largest errors": [_run_table(results, columns, findings.worst(results, MOST_ROWS))] if known else [],
        "Failed runs": _failures(results, columns),
        "How it was made": [facts(making), collapsed("Campaign, its base written out", as_yaml(campaign))],
    }
    made = {title: blocks for title, blocks in parts.items() if any(blocks)}
    sentence, good = findings.verdict_sentence(results)
    write_page(
        path,
        title=str(campaign["title"]),
        subtitle=f"Campaign of {number(len(results['run']))} experiments",
        blocks=[
            verdict(sentence, good=good),
            contents(made),
            *(block for title, blocks in made.items() for block in (heading(title), *blocks)),
        ],
    )


def _group_table(results: Results, groups: Sequence[Group]) -> str:
    errors, times = numbers(results, ERROR), numbers(results, CONVERGENCE)
    failures = set(findings.failed(results))
    header = ["", "runs", "failed", "median error", "95 %", "largest", "median convergence"]
    rows: list[list[str | Entry]] = []
    for group in groups:
        lost = len(failures.intersection(group.rows.tolist()))
        levels = [f"{number(findings.quantile(errors[group.rows], share))} N" for share in (0.5, 0.95, 1.0)]
        settled = f"{number(findings.quantile(times[group.rows], 0.5))} s"
        rows.append([group.name, number(group.rows.size), Entry(number(lost), heat=0.5 if lost else 0.0), *levels, settled])
    return table(header, rows)


def _sweeps(results: Results, columns: Sequence[Column], groups: Sequence[Group]) -> list[str]:
    swept = [c for c in columns if c.numeric and not c.drawn and np.unique(numbers(results, c.path)).size > 1]
    if not swept:
        return []
    maps = [drawn.heat_map(results, swept[0], swept[1], group) for group in groups[:MOST_GROUPS]] if len(swept) > 1 else []
    lines = [drawn.sweep(results, column, groups[:MOST_GROUPS]) for column in swept]
    return [figures(lines, columns=2), figures(maps, columns=2), *_rest(groups)]


def _draws(results: Results, columns: Sequence[Column], groups: Sequence[Group]) -> list[str]:
    parameters = [column for column in columns if column.drawn and column.path != SEED]
    if not any(column.drawn for column in columns):
        return []
    shown = groups[:MOST_GROUPS]
    blocks = [figures([drawn.distribution(results, shown)])]
    if parameters:
        found = np.nan_to_num([findings.correlations(results, parameters, group) for group in shown])
        strongest = np.argsort(-np.abs(found).max(axis=0), kind="stable")[:4]
        blocks += [
            paragraph(findings.influence_remark(results, parameters, shown)),
            figures([drawn.influence(results, parameters, shown)]),
            figures([drawn.scatter(results, parameters[i], shown) for i in strongest], columns=2),
        ]
    return [*blocks, *_rest(groups)]


def _rest(groups: Sequence[Group]) -> list[str]:
    left = len(groups) - MOST_GROUPS
    return [paragraph(f"The figures show the first {MOST_GROUPS} groups; {left} more are in the table.")] if left > 0 else []


def _run_table(results: Results, columns: Sequence[Column], rows: Sequence[int]) -> str:
    shown = _told(columns)
    body = [
        [
            number(results["run"][row]),
            f"{number(results[ERROR][row])} N",
            "never" if results[CONVERGENCE][row] is None else f"{number(results[CONVERGENCE][row])} s",
            *(_value(results[column.path][row]) for column in shown),
        ]
        for row in rows
    ]
    return table(["run", "largest error", "convergence", *map(_with_unit, shown)], body)


def _failures(results: Results, columns: Sequence[Column]) -> list[str]:
    rows = findings.failed(results)
    if not rows:
        return []
    shown = _told(columns)
    body: list[list[str | Entry]] = [
        [
            number(results["run"][row]),
            Entry(str(results["error"][row]), prose=True),
            *(_value(results[column.path][row]) for column in shown),
        ]
        for row in rows[:MOST_ROWS]
    ]
    more = [paragraph(f"The first {MOST_ROWS} of {number(len(rows))}.")] if len(rows) > MOST_ROWS else []
    return [*more, table(["run", "error", *map(_with_unit, shown)], body)]


def _told(columns: Sequence[Column]) -> list[Column]:
    """Return the columns a table of single runs has room for: the grid's, or the draws' where there is no grid."""
    return ([column for column in columns if not column.drawn] or list(columns))[:MOST_COLUMNS]


def _with_unit(column: Column) -> str:
    return f"{column.path} [{column.unit}]" if column.unit else column.path


def _value(value: object) -> str:
    return value if isinstance(value, str) else number(value, 4)
