"""Statistics of a campaign: groups of runs, and correlations of the error."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.experiments.campaign.plan import Column
from ehls_ros.experiments.campaign.results import CampaignResults, quantile
from ehls_ros.report.page import number
from ehls_ros.report.plot import NEWTON

LARGE_CORRELATION = 0.3
"""Smallest rank correlation for which a parameter is named as correlated with the error."""


class Group(NamedTuple):
    """Runs that share all non-numeric values.

    Attributes:
        name: the shared values.
        rows: their rows in the table.
    """

    name: str
    rows: NDArray[np.intp]


def groups(results: CampaignResults) -> list[Group]:
    """Group the runs by their varied non-numeric values, in the order of the table."""
    differing = [values for values in results.words.values() if len(set(values)) > 1]
    rows: dict[tuple[str, ...], list[int]] = {}
    for row in range(len(results)):
        rows.setdefault(tuple(values[row] for values in differing), []).append(row)
    return [Group(" · ".join(key) or "all runs", np.array(members)) for key, members in rows.items()]


def worst(results: CampaignResults, count: int) -> list[int]:
    """Return the rows of the largest errors, largest first."""
    order = np.argsort(-results.max_error_n, kind="stable")
    return [int(row) for row in order[:count] if np.isfinite(results.max_error_n[row])]


def rank_correlation(x: Array, y: Array) -> float:
    """Return Spearman's coefficient of the finite pairs, NaN if it is not defined."""
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0.0 or np.ptp(y[known]) == 0.0:
        return float("nan")
    # Equal values share a rank; drawn values are all different.
    ranks = np.array([np.unique(values[known], return_inverse=True)[1] for values in (x, y)], dtype=np.float64)
    return float(np.asarray(np.corrcoef(ranks))[0, 1])


def correlations(results: CampaignResults, columns: Sequence[Column], group: Group) -> Array:
    """Return the rank correlation of the largest error with each column, within a group."""
    errors = results.max_error_n[group.rows]
    return np.array([rank_correlation(results.numbers[column.path][group.rows], errors) for column in columns])


def verdict_sentence(results: CampaignResults) -> tuple[str, bool | None]:
    """Summarise the campaign.

    Returns:
        The sentence, and False if a run failed or never converged, else None if a run has no force error, else True.
    """
    errors, lost, not_converged = results.max_error_n, len(results.failed), len(results.not_converged)
    unevaluated = int(np.isnan(errors).sum()) - lost
    parts = [f"{number(len(errors))} runs"]
    if np.isfinite(errors).any():
        parts.append(
            f"largest error at most {number(quantile(errors, 0.5))} {NEWTON.symbol} in half of them,"
            f" {number(quantile(errors, 0.95))} {NEWTON.symbol} in 95 %,"
            f" {number(quantile(errors, 1.0))} {NEWTON.symbol} in the worst"
        )
    if lost:
        parts.append(f"{number(lost)} failed")
    if not_converged:
        the_worst = ", the worst among them" if worst(results, 1)[0] in results.not_converged else ""
        parts.append(f"{number(not_converged)} never converged{the_worst}")
    if unevaluated > 0:
        parts.append(f"{number(unevaluated)} without a force error")
    if lost or not_converged:
        return f"{'; '.join(parts)}.", False
    return f"{'; '.join(parts)}.", None if unevaluated > 0 else True


def influence_remark(results: CampaignResults, columns: Sequence[Column], within: Sequence[Group]) -> str:
    """Return a remark on the parameters most strongly correlated with the largest error in each group."""
    parts = []
    for group in within:
        found = correlations(results, columns, group)
        strong = [i for i in np.argsort(-np.abs(found)) if abs(found[i]) >= LARGE_CORRELATION][:3]
        named = ", ".join(f"{columns[i].path} ({'+' if found[i] > 0 else '−'}{number(abs(found[i]), 2)})" for i in strong)
        parts.append(f"{group.name}: {named or 'no parameter stands out'}")
    return f"Strongest rank correlations of the largest error, in brackets. {'; '.join(parts)}."
