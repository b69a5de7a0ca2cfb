"""What is allowed for without any fault: an expectation, and directions in which a residual may vary around it.

An allowance is a normal prior on what is nobody's fault: a skew between two channels, the natural spread of a healthy rig. It
is marginalised once: along its directions, residuals are reduced so that they scatter as all others do. Every hypothesis is
compared by these residuals, and gains nothing from what is allowed for.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules


class Allowance(NamedTuple):
    """What a channel's residual is expected to be without any fault, and how far it may vary around that.

    Attributes:
        mean: expected residual of each usable window, in the channel's unit, shape (n,).
        directions: factor of the covariance of what may vary for all windows together, in the channel's unit, shape (n, m).
        variance: of what varies beside that from window to window, in the square of the channel's unit, shape (n,).
        alike: number of neighbouring windows over which the latter is alike.
        most: standard deviations beyond which a variation counts :data:`rules.EDGE` times as much, or in full.
    """

    mean: Array
    directions: Array
    variance: Array
    alike: float = 1.0
    most: float = math.inf

    def whitening(self, floor: Array, correlation: float = 1.0) -> "Allowed":
        """Return the allowance as residuals divided by a floor need it.

        Args:
            floor: noise floor of each window, the allowance's own variance included, shape (n,).
            correlation: number of windows over which residuals are alike.
        """
        directions = self.directions / floor[:, None]
        squares, along = np.linalg.eigh(directions.T @ directions)
        kept = squares > rules.LEAST_ALLOWED * correlation
        basis = directions @ along[:, kept] / np.sqrt(squares[kept])
        return Allowed(self.mean, basis, np.sqrt(1.0 + squares[kept] / correlation), self.most * np.sqrt(1.0 + squares[kept]))


class Allowed(NamedTuple):
    """An allowance as whitened residuals need it.

    Attributes:
        mean: expected residual, in the channel's unit, shape (n,).
        basis: orthonormal directions that may vary, of residuals divided by their floor, shape (n, m).
        deviations: standard deviation of a residual along each in units of the others', noise included, shape (m,).
        bounds: largest residual along each that is allowed for; what exceeds it counts :data:`rules.EDGE` times as much, or in
            full, shape (m,).
    """

    mean: Array
    basis: Array
    deviations: Array
    bounds: Array

    def whitened(self, e: Array) -> Array:
        """Return residuals divided by their floor with less weight on what is allowed for."""
        along = self.basis.T @ e
        within = np.clip(along, -self.bounds, self.bounds)
        counted = within / self.deviations + (along - within) / self._beyond()
        reduced: Array = e - self.basis @ (along - counted)
        return reduced

    def whole(self, e: Array) -> Array:
        """Return residuals with what the whitening took off again."""
        counted = self.basis.T @ e
        bounds = self.bounds / self.deviations
        within = np.clip(counted, -bounds, bounds)
        full: Array = e + self.basis @ (within * self.deviations + (counted - within) * self._beyond() - counted)
        return full

    def _beyond(self) -> Array:
        """Return by how much a variation is reduced beyond the bounds."""
        return np.maximum(1.0, self.deviations / rules.EDGE)


def together(allowances: Sequence[Allowance]) -> Allowance:
    """Return what several independent allowances make together; it is bounded only if all are."""
    return Allowance(
        np.sum([a.mean for a in allowances], axis=0),
        np.hstack([a.directions for a in allowances]),
        np.sum([a.variance for a in allowances], axis=0),
        max(a.alike for a in allowances),
        max(a.most for a in allowances),
    )
