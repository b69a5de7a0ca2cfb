"""Allowances for fault-free variation: an expected residual, and directions in which it may vary.

An allowance is a normal prior on deviations that are no fault, such as a skew between two channels or the healthy spread of a
healthy rig. It is marginalised once: along its directions, residuals are shrunk to the scatter of all others. All hypotheses
are compared by these residuals, and gain nothing from allowed variation.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules

MIN_ALLOWED = 0.01
"""Variance in units of the noise below which a direction is not allowed for."""


class Allowance(NamedTuple):
    """Expectation and variation of a channel's fault-free residual.

    Attributes:
        mean: expected residual of each usable window, in the channel's unit, shape (n,).
        directions: covariance factor of the variation common to all windows, in the channel's unit, shape (n, m).
        variance: of the remaining variation of each window, in the square of the channel's unit, shape (n,).
        correlated: number of neighbouring windows over which the latter is correlated.
        most: standard deviations beyond which a variation is weighted :data:`rules.EDGE` times, at most with full weight.
    """

    mean: Array
    directions: Array
    variance: Array
    correlated: float = 1.0
    most: float = math.inf

    def whitening(self, floor: Array, correlation: float = 1.0) -> "Allowed":
        """Return the allowance prepared for residuals divided by a noise floor.

        Args:
            floor: noise floor of each window, the allowance's variance included, shape (n,).
            correlation: number of windows over which residuals are correlated.
        """
        directions = self.directions / floor[:, None]
        squares, along = np.linalg.eigh(directions.T @ directions)
        kept = squares > MIN_ALLOWED * correlation
        basis = directions @ along[:, kept] / np.sqrt(squares[kept])
        return Allowed(self.mean, basis, np.sqrt(1.0 + squares[kept] / correlation), self.most * np.sqrt(1.0 + squares[kept]))


class Allowed(NamedTuple):
    """An allowance prepared for whitened residuals.

    Attributes:
        mean: expected residual, in the channel's unit, shape (n,).
        basis: orthonormal directions of allowed variation, for residuals divided by their floor, shape (n, m).
        deviations: standard deviation of a residual along each in units of the others', noise included, shape (m,).
        bounds: largest allowed residual along each; the excess is weighted :data:`rules.EDGE` times, at most with full weight,
            shape (m,).
    """

    mean: Array
    basis: Array
    deviations: Array
    bounds: Array

    def whitened(self, e: Array) -> Array:
        """Return residuals, divided by their floor, with allowed variation down-weighted."""
        along = self.basis.T @ e
        within = np.clip(along, -self.bounds, self.bounds)
        counted = within / self.deviations + (along - within) / self._beyond()
        reduced: Array = e - self.basis @ (along - counted)
        return reduced

    @property
    def is_bounded(self) -> bool:
        """Whether there is a largest size to each allowed variation."""
        return bool(np.all(np.isfinite(self.bounds)))

    def unbounded(self) -> "Allowed":
        """Return the allowance without bounds."""
        return self._replace(bounds=np.full_like(self.bounds, math.inf))

    def whole(self, e: Array) -> Array:
        """Return whitened residuals with the allowed variation restored."""
        counted = self.basis.T @ e
        bounds = self.bounds / self.deviations
        within = np.clip(counted, -bounds, bounds)
        full: Array = e + self.basis @ (within * self.deviations + (counted - within) * self._beyond() - counted)
        return full

    def beyond(self, e: Array) -> Array:
        """Return residuals, divided by their floor, less the variation within the bounds."""
        along = self.basis.T @ e
        left: Array = e - self.basis @ np.clip(along, -self.bounds, self.bounds)
        return left

    def outside(self, e: Array) -> Array:
        """Return residuals, or columns of them, divided by their floor, without their parts along the allowed directions."""
        left: Array = e - self.basis @ (self.basis.T @ e)
        return left

    def _beyond(self) -> Array:
        """Return the divisor of variations beyond the bounds."""
        return np.maximum(1.0, self.deviations / rules.EDGE)


def together(allowances: Sequence[Allowance]) -> Allowance:
    """Return the combination of several independent allowances; it is bounded only if all are."""
    return Allowance(
        np.sum([a.mean for a in allowances], axis=0),
        np.hstack([a.directions for a in allowances]),
        np.sum([a.variance for a in allowances], axis=0),
        max(a.correlated for a in allowances),
        max(a.most for a in allowances),
    )
