"""Report of a campaign: the distribution of its runs' errors, and the parameters on which they depend."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ehls_ros.experiments.campaign.plan import Column
from ehls_ros.experiments.campaign.results import CampaignResults, quantile
from ehls_ros.report import campaign_figures as drawn
from ehls_ros.report import campaign_findings as findings
from ehls_ros.report import page
from ehls_ros.report.campaign_findings import Group
from ehls_ros.report.page import MISSING_NUMBER, Configuration, Entry, Row, number

MOST_GROUPS, MOST_ROWS, MOST_COLUMNS = 8, 10, 6
"""Maximum numbers of groups in a figure, of rows in a table of single runs, and of varied columns in it."""

SEED = "seed"
"""Drawn column that is not a parameter."""


def write_campaign_report(
    results: CampaignResults, campaign: Configuration, making: Sequence[tuple[str, str]], path: Path
) -> None:
    """Write one self-contained HTML file that shows the campaign.

    Args:
        results: the results.
        campaign: the campaign file with its base written out.
        making: label and value of each fact on the origin of the results.
        path: file to write; its folder must exist.
    """
    groups = findings.groups(results)
    known = bool(np.isfinite(results.max_error_n).any())
    parts = [
        ("Groups", [_group_table(results, groups)]),
        ("Sweeps", _sweeps(results, groups) if known else []),
        ("Draws", _draws(results, groups) if known else []),
        ("Largest errors", [_run_table(results, findings.worst(results, MOST_ROWS))] if known else []),
        ("Failed runs", _failures(results)),
        ("How it was made", [page.facts(making), page.collapsed("Campaign with its base written out", page.as_yaml(campaign))]),
    ]
    sentence, good = findings.verdict_sentence(results)
    page.write_page(
        path,
        title=str(campaign["title"]),
        subtitle=f"Campaign of {number(len(results))} experiments",
        blocks=[page.verdict(sentence, good=good), *page.sections(parts)],
    )


def _group_table(results: CampaignResults, groups: Sequence[Group]) -> str:
    errors, times = results.max_error_n, results.convergence_s
    header = ["", "runs", "failed", "median error", "95 %", "largest", "median convergence"]
    rows: list[Row] = []
    for group in groups:
        lost = len(np.intersect1d(results.failed, group.rows))
        levels = [_in(quantile(errors[group.rows], share), "N") for share in (0.5, 0.95, 1.0)]
        settled = _in(quantile(times[group.rows], 0.5), "s")
        rows.append([group.name, number(group.rows.size), Entry(number(lost), heat=0.5 if lost else 0.0), *levels, settled])
    return page.table(header, rows)


def _in(value: float, unit: str) -> str:
    """Write a value with its unit, or a dash if it is not finite."""
    return f"{number(value)} {unit}" if np.isfinite(value) else MISSING_NUMBER


def _sweeps(results: CampaignResults, groups: Sequence[Group]) -> list[str]:
    swept = [c for c in results.columns if c.numeric and not c.drawn and np.unique(results.numbers[c.path]).size > 1]
    if not swept:
        return []
    maps = [drawn.heat_map(results, swept[0], swept[1], group) for group in groups[:MOST_GROUPS]] if len(swept) > 1 else []
    lines = [drawn.sweep(results, column, groups[:MOST_GROUPS]) for column in swept]
    return [page.figures(lines, columns=2), page.figures(maps, columns=2), *_rest(groups)]


def _draws(results: CampaignResults, groups: Sequence[Group]) -> list[str]:
    parameters = [column for column in results.columns if column.drawn and column.path != SEED]
    if not any(column.drawn for column in results.columns):
        return []
    shown = groups[:MOST_GROUPS]
    blocks = [page.figures([drawn.distribution(results, shown)])]
    if parameters:
        found = np.nan_to_num([findings.correlations(results, parameters, group) for group in shown])
        strongest = np.argsort(-np.abs(found).max(axis=0), kind="stable")[:4]
        blocks += [
            page.paragraph(findings.influence_remark(results, parameters, shown)),
            page.figures([drawn.influence(results, parameters, shown)]),
            page.figures([drawn.scatter(results, parameters[i], shown) for i in strongest], columns=2),
        ]
    return [*blocks, *_rest(groups)]


def _rest(groups: Sequence[Group]) -> list[str]:
    left = len(groups) - MOST_GROUPS
    return [page.paragraph(f"The figures show the first {MOST_GROUPS} groups; the table has {left} more.")] if left > 0 else []


def _run_table(results: CampaignResults, rows: Sequence[int]) -> str:
    shown = _told(results.columns)
    body: list[Row] = []
    for row in rows:
        settled = results.convergence_s[row]
        convergence = "never" if np.isnan(settled) else f"{number(settled)} s"
        body.append([number(row), f"{number(results.max_error_n[row])} N", convergence, *_values(results, shown, row)])
    return page.table(["run", "largest error", "convergence", *map(_with_unit, shown)], body)


def _failures(results: CampaignResults) -> list[str]:
    rows = results.failed
    if not rows.size:
        return []
    shown = _told(results.columns)
    body: list[Row] = [[number(row), results.failures[row] or "", *_values(results, shown, row)] for row in rows[:MOST_ROWS]]
    more = [page.paragraph(f"The first {MOST_ROWS} of {number(len(rows))}.")] if len(rows) > MOST_ROWS else []
    return [*more, page.table(["run", "error", *map(_with_unit, shown)], body)]


def _values(results: CampaignResults, columns: Sequence[Column], row: int) -> list[str]:
    """Write the varied values of a run."""
    numbers, words = results.numbers, results.words
    return [number(numbers[column.path][row], 4) if column.numeric else words[column.path][row] for column in columns]


def _told(columns: Sequence[Column]) -> list[Column]:
    """Return the columns for a table of single runs: those of the grid, or those of the draws if there is no grid."""
    return ([column for column in columns if not column.drawn] or list(columns))[:MOST_COLUMNS]


def _with_unit(column: Column) -> str:
    return f"{column.path} [{column.unit}]" if column.unit else column.path
