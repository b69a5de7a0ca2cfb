"""Results of a campaign as frozen records: its table, and the summary printed by ``--json``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.experiments.campaign.plan import Column


@dataclass(frozen=True)
class CampaignResults:
    """The table of a campaign, one entry per run in the order of their numbers.

    Attributes:
        columns: varied paths.
        max_error_n: largest steady error [N], NaN where a run has none, shape (runs,).
        convergence_s: convergence time [s], NaN where a run did not converge, shape (runs,).
        failures: error of each run; None if it succeeded.
        numbers: values of each numeric column by its path, shape (runs,).
        words: values of each other column by its path.
    """

    columns: tuple[Column, ...]
    max_error_n: Array
    convergence_s: Array
    failures: tuple[str | None, ...]
    numbers: Mapping[str, Array]
    words: Mapping[str, tuple[str, ...]]

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.failures)

    @property
    def failed(self) -> NDArray[np.intp]:
        """Rows of the runs that failed."""
        return np.flatnonzero([failure is not None for failure in self.failures])

    @property
    def not_converged(self) -> NDArray[np.intp]:
        """Rows of the complete runs whose error did not converge."""
        ended = np.array([failure is None for failure in self.failures], dtype=bool)
        return np.flatnonzero(ended & np.isfinite(self.max_error_n) & np.isnan(self.convergence_s))


def results_of(columns: Sequence[Column], table: Mapping[str, Sequence[Any]]) -> CampaignResults:
    """Return the results in a table.

    Args:
        columns: varied paths.
        table: its columns by name, as :func:`~ehls_ros.experiments.campaign.store.read_results` returns them.
    """
    return CampaignResults(
        tuple(columns),
        _numbers(table["max_error_n"]),
        _numbers(table["convergence_s"]),
        tuple(table["error"]),
        {column.path: _numbers(table[column.path]) for column in columns if column.numeric},
        {column.path: tuple(table[column.path]) for column in columns if not column.numeric},
    )


def _numbers(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def quantile(values: Array, share: float) -> float:
    """Return the smallest value not exceeded by a fraction of the finite ones; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share, method="inverted_cdf")) if known.size else float("nan")


class Summary(NamedTuple):
    """Output of ``ehls campaign --json``; the field names are the keys.

    Attributes:
        runs: number of runs.
        made: number of runs made by this call; the others existed before.
        failed: number of failed runs.
        not_converged: number of complete runs whose error did not converge.
        median_max_error_n, p95_max_error_n, largest_max_error_n: quantiles of the largest steady error [N].
        wall_s: wall time of this call [s].
        results, report: paths of table and report.
    """

    runs: int
    made: int
    failed: int
    not_converged: int
    median_max_error_n: float
    p95_max_error_n: float
    largest_max_error_n: float
    wall_s: float
    results: str
    report: str
