"""What a campaign's table says: groups, quantiles, what the error goes with."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report.page import number
from ehls_ros.report.plot import NEWTON

Results = Mapping[str, Sequence[Any]]
"""The table's columns by name; None where a run has no value."""

ERROR, CONVERGENCE = "max_error_n", "convergence_s"

LARGE_CORRELATION = 0.3
"""Rank correlation below which a parameter is not named as what the error goes with."""


class Column(Protocol):
    """A varied path."""

    @property
    def path(self) -> str:
        """Dotted path into the spec."""

    @property
    def unit(self) -> str:
        """Unit of its numbers, empty where it has none."""

    @property
    def numeric(self) -> bool:
        """Whether all its values are numbers."""

    @property
    def drawn(self) -> bool:
        """Whether it is drawn at random."""


class Group(NamedTuple):
    """Runs that share all that is no number.

    Attributes:
        name: what they share.
        rows: their places in the table.
    """

    name: str
    rows: NDArray[np.intp]


def numbers(results: Results, name: str) -> NDArray[np.float64]:
    """Return a column as numbers, shape (runs,), NaN where a run has none."""
    return np.array([np.nan if value is None else value for value in results[name]], dtype=np.float64)


def groups(results: Results, columns: Sequence[Column]) -> list[Group]:
    """Part the runs by what is varied and no number, in the order of the table."""
    texts = [column.path for column in columns if not column.numeric]
    differing = [path for path in texts if len(set(results[path])) > 1]
    rows: dict[tuple[Any, ...], list[int]] = {}
    for row in range(len(results["run"])):
        rows.setdefault(tuple(results[path][row] for path in differing), []).append(row)
    return [Group(" · ".join(map(str, key)) or "all runs", np.array(members)) for key, members in rows.items()]


def quantile(values: NDArray[np.float64], share: float) -> float:
    """Return the smallest value that a share of the finite ones does not exceed, NaN where there is none."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share, method="inverted_cdf")) if known.size else float("nan")


def failed(results: Results) -> list[int]:
    """Return the rows of the runs that failed."""
    return [row for row, error in enumerate(results["error"]) if error is not None]


def unsettled(results: Results) -> int:
    """Return how many runs did not fail and yet never converged."""
    rows = zip(results["error"], results[ERROR], results[CONVERGENCE], strict=True)
    return sum(failure is None and error is not None and time is None for failure, error, time in rows)


def worst(results: Results, count: int) -> list[int]:
    """Return the rows of the largest errors, largest first."""
    errors = numbers(results, ERROR)
    order = np.argsort(-errors, kind="stable")
    return [int(row) for row in order[:count] if np.isfinite(errors[row])]


def rank_correlation(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return Spearman's coefficient of the pairs that are known, NaN where it is not defined."""
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0.0 or np.ptp(y[known]) == 0.0:
        return float("nan")
    # Equal values share a rank; what is drawn has none.
    ranks = np.array([np.unique(values[known], return_inverse=True)[1] for values in (x, y)], dtype=np.float64)
    return float(np.asarray(np.corrcoef(ranks))[0, 1])


def correlations(results: Results, columns: Sequence[Column], group: Group) -> NDArray[np.float64]:
    """Return the rank correlation of the largest error with each column, within a group."""
    errors = numbers(results, ERROR)[group.rows]
    return np.array([rank_correlation(numbers(results, column.path)[group.rows], errors) for column in columns])


def verdict_sentence(results: Results) -> tuple[str, bool]:
    """Sum the campaign up.

    Returns:
        The sentence, and whether every run ended and converged.
    """
    errors, lost, open_ended = numbers(results, ERROR), len(failed(results)), unsettled(results)
    parts = [f"{number(len(errors))} runs"]
    if np.isfinite(errors).any():
        parts.append(
            f"largest error at most {number(quantile(errors, 0.5))} {NEWTON.symbol} in half of them,"
            f" {number(quantile(errors, 0.95))} {NEWTON.symbol} in 95 %,"
            f" {number(quantile(errors, 1.0))} {NEWTON.symbol} in the worst"
        )
    if lost:
        parts.append(f"{number(lost)} failed")
    if open_ended:
        parts.append(f"{number(open_ended)} never converged")
    return f"{'; '.join(parts)}.", not lost and not open_ended


def influence_remark(results: Results, columns: Sequence[Column], within: Sequence[Group]) -> str:
    """Say what the largest error goes with most in each group."""
    said = []
    for group in within:
        found = correlations(results, columns, group)
        strong = [i for i in np.argsort(-np.abs(found)) if abs(found[i]) >= LARGE_CORRELATION][:3]
        named = ", ".join(f"{columns[i].path} ({'+' if found[i] > 0 else '−'}{number(abs(found[i]), 2)})" for i in strong)
        said.append(f"{group.name}: {named or 'nothing drawn stands out'}")
    return f"What the largest error goes with most, rank correlation in brackets. {'; '.join(said)}."
