"""Report of a campaign: the distribution of its runs' errors, and the parameters on which they depend."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ehls_ros.experiments.campaign.plan import Column
from ehls_ros.experiments.campaign.results import CampaignResults, quantile
from ehls_ros.report import campaign_figures as drawn
from ehls_ros.report import campaign_findings as findings
from ehls_ros.report import page
from ehls_ros.report.campaign_findings import Group
from ehls_ros.report.page import Configuration, Entry, number, with_unit

MAX_GROUPS, MAX_ROWS, MAX_COLUMNS = 8, 10, 6
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
        ("Largest errors", [_run_table(results, findings.worst(results, MAX_ROWS))] if known else []),
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
    def level(values: NDArray[np.float64], share: float, unit: str) -> Callable[[Group], str]:
        return lambda group: with_unit(quantile(values[group.rows], share), unit)

    def lost(group: Group) -> Entry:
        count = len(np.intersect1d(results.failed, group.rows))
        return Entry(number(count), heat=0.5 if count else 0.0)

    columns = {
        "": lambda group: group.name,
        "runs": lambda group: number(group.rows.size),
        "failed": lost,
        "median error": level(results.max_error_n, 0.5, "N"),
        "95 %": level(results.max_error_n, 0.95, "N"),
        "largest": level(results.max_error_n, 1.0, "N"),
        "median convergence": level(results.convergence_s, 0.5, "s"),
    }
    return page.table_of(groups, columns)


def _sweeps(results: CampaignResults, groups: Sequence[Group]) -> list[str]:
    swept = [c for c in results.columns if c.numeric and not c.drawn and np.unique(results.numbers[c.path]).size > 1]
    if not swept:
        return []
    maps = [drawn.heat_map(results, swept[0], swept[1], group) for group in groups[:MAX_GROUPS]] if len(swept) > 1 else []
    lines = [drawn.sweep(results, column, groups[:MAX_GROUPS]) for column in swept]
    return [page.figures(lines, columns=2), page.figures(maps, columns=2), *_rest(groups)]


def _draws(results: CampaignResults, groups: Sequence[Group]) -> list[str]:
    parameters = [column for column in results.columns if column.drawn and column.path != SEED]
    if not any(column.drawn for column in results.columns):
        return []
    shown = groups[:MAX_GROUPS]
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
    left = len(groups) - MAX_GROUPS
    return [page.paragraph(f"The figures show the first {MAX_GROUPS} groups; the table has {left} more.")] if left > 0 else []


def _run_table(results: CampaignResults, rows: Sequence[int]) -> str:
    columns: dict[str, Callable[[int], str]] = {
        "run": number,
        "largest error": lambda row: f"{number(results.max_error_n[row])} N",
        "convergence": lambda row: with_unit(results.convergence_s[row], "s", "never"),
    }
    return page.table_of(rows, columns | _varied(results))


def _failures(results: CampaignResults) -> list[str]:
    rows = results.failed
    more = [page.paragraph(f"The first {MAX_ROWS} of {number(len(rows))}.")] if len(rows) > MAX_ROWS else []
    columns: dict[str, Callable[[int], str]] = {"run": number, "error": lambda row: results.failures[row] or ""}
    return [*more, page.table_of(rows[:MAX_ROWS], columns | _varied(results))]


def _varied(results: CampaignResults) -> dict[str, Callable[[int], str]]:
    """Return the columns of the values varied over the grid, or drawn if there is no grid, for a table of single runs."""
    chosen = [column for column in results.columns if not column.drawn] or list(results.columns)
    return {
        f"{column.path} [{column.unit}]" if column.unit else column.path: partial(_value, results, column)
        for column in chosen[:MAX_COLUMNS]
    }


def _value(results: CampaignResults, column: Column, row: int) -> str:
    return number(results.numbers[column.path][row], 4) if column.numeric else results.words[column.path][row]
