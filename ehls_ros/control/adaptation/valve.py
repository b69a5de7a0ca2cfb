"""Estimate gain, bandwidth and delay of the valve (4) from the spool and the commands.

The spool response to the commands by the rig file's bandwidth is free of noise. The measured spool is a weighted sum of this
response at two neighbouring delays (which covers the delays between them), of its slope over the bandwidth, and of an offset:

    xv = c0 z(t - n T) + c1 z(t - (n + 1) T) + c2 omega dz/domega + c3,    Kv = c0 + c1,    c1/Kv from the fraction of a cycle

A command that acts f later than a whole cycle has the weight 1 - exp(-omega (T - f)) in the first cycle and the rest in the
next, so the sum is exact. Among the delays of a bank, the one with the smallest residual is chosen.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.adaptation.least_squares import Fit, gather, solve, symmetric

INITIAL_TIME_CONSTANTS = 10.0
"""Time constants of the valve after which its initial state is forgotten."""

EXTRA = 2
"""Cycles of delay in the bank beyond those within reach, to detect a larger delay."""

OUTSIDE = 0.2
"""Distance, in cycles, by which a delay may be outside its pair of the bank."""

OFFSET = 1e-4
"""Scale of the spool's offset in the sums [m]."""

GAIN_FLOOR, BANDWIDTH_FLOOR, DELAY_FLOOR = 1e-3, 5e-3, 0.01
"""Least standard errors of gain and bandwidth, and of the delay in cycles, due to the linearity of the spool sensor."""

BANDWIDTH_PRIOR_STD = 0.3
"""Prior standard deviation of the bandwidth's relative error."""


class Bank(NamedTuple):
    """Bank of delays to compare.

    Attributes:
        first: smallest delay, in cycles.
        delays: number of delays.
        bandwidth: valve bandwidth with which the spool is computed [rad/s].
        gain: the rig file's valve gain.
        period: control period [s].
    """

    first: int
    delays: int
    bandwidth: float
    gain: float
    period: float

    @property
    def settled(self) -> int:
        """Cycles until the initial state is forgotten."""
        return math.ceil(INITIAL_TIME_CONSTANTS / self.bandwidth / self.period) + self.first + self.delays


class Found(NamedTuple):
    """Estimates of the valve.

    Attributes:
        gain, gain_std: valve gain relative to the rig file's, and its standard error.
        bandwidth, bandwidth_std: bandwidth relative to the bank's, and its standard error.
        delay, delay_std: delay of the command and its standard error [s].
    """

    gain: float
    gain_std: float
    bandwidth: float
    bandwidth_std: float
    delay: float
    delay_std: float


def columns(count: int) -> int:
    """Return the number of entries of a row: spools and slopes for each delay, the offset, and the measured spool."""
    return 2 * count + 2


@kernel
def follow(command: float, bank: Bank, past: Array) -> None:
    """Compute the spool at the end of a cycle.

    Args:
        command: spool command of the cycle [m].
        bank: the delays.
        past: spools [m] and their slopes omega dz/domega [m], the newest first, shape (2, first + delays); updated.
    """
    decay = math.exp(-bank.bandwidth * bank.period)
    missing = bank.gain * command - past[0, 0]
    slope = decay * (past[1, 0] + bank.bandwidth * bank.period * missing)
    for i in range(past.shape[1] - 1, 0, -1):
        past[0, i], past[1, i] = past[0, i - 1], past[1, i - 1]
    past[0, 0] += (1.0 - decay) * missing
    past[1, 0] = slope


@kernel
def spool_at(delay: float, bank: Bank, past: Array) -> float:
    """Return the computed spool position [m] for a delay [s]."""
    cycles = min(max(delay / bank.period, 0.0), past.shape[1] - 1.0)
    whole_cycles = min(int(cycles), past.shape[1] - 2)
    fraction = cycles - whole_cycles
    return past[0, whole_cycles] + fraction * (past[0, whole_cycles + 1] - past[0, whole_cycles])


@kernel
def compare(spool: float, bank: Bank, past: Array, fading: float, row: Array, sums: Array, count: Array) -> None:
    """Add one reading of the spool [m] to the sums; ``row`` is scratch."""
    for i in range(bank.delays):
        row[i] = past[0, bank.first + i]
        row[bank.delays + i] = past[1, bank.first + i]
    row[2 * bank.delays] = OFFSET
    row[2 * bank.delays + 1] = spool
    gather(row, fading, sums, count)


def find(bank: Bank, sums: Array, count: float) -> Found | None:
    """Return the valve that fits the spool best; None if the commands do not determine it."""
    sums = symmetric(sums)
    # Delays inside their pair take precedence; a delay beyond the bank is used only if there is none.
    candidates: list[tuple[bool, float, int, Fit]] = []
    for i in range(bank.delays - 1):
        pick = np.zeros((len(sums), 5))
        pick[i, 0] = pick[i + 1, 1] = 1.0
        pick[bank.delays + i, 2] = pick[bank.delays + i + 1, 2] = 0.5
        pick[-2, 3] = pick[-1, 4] = 1.0
        fit = solve(pick.T @ sums @ pick, count, np.zeros(4), np.array([0.0, 0.0, 1.0 / BANDWIDTH_PRIOR_STD, 0.0]))
        if fit is None or fit.values[0] + fit.values[1] <= 0.0:
            continue
        share = fit.values[1] / (fit.values[0] + fit.values[1])
        candidates.append((not -OUTSIDE <= share <= 1.0 + OUTSIDE, fit.residual, bank.first + i, fit))
    if not candidates:
        return None
    _, _, cycles, fit = min(candidates)
    return _found(bank, fit, cycles)


def _found(bank: Bank, fit: Fit, whole_cycles: int) -> Found:
    gain = fit.values[0] + fit.values[1]
    share = fit.values[1] / gain
    bandwidth = 1.0 + fit.values[2] / gain
    decay = math.exp(-bank.bandwidth * bank.period)
    inside = min(max(share, 0.0), 1.0)
    # The share of the next cycle is (exp(-omega (T - f)) - exp(-omega T)) / (1 - exp(-omega T)).
    later = bank.period + math.log(decay + inside * (1.0 - decay)) / bank.bandwidth + (share - inside) * bank.period
    weight = np.array([-share, 1.0 - share, 0.0, 0.0]) / gain
    return Found(
        gain,
        math.hypot(fit.std(np.array([1.0, 1.0, 0.0, 0.0])), GAIN_FLOOR),
        bandwidth,
        math.hypot(fit.std(np.array([1.0 - bandwidth, 1.0 - bandwidth, 1.0, 0.0]) / gain), BANDWIDTH_FLOOR),
        max(whole_cycles * bank.period + later, 0.0),
        math.hypot(fit.std(weight), DELAY_FLOOR) * bank.period,
    )
