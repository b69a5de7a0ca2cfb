"""Sine fits by least squares: three- and four-parameter methods of IEEE Std 1057, and their extension to harmonics.

The fit is linear for a known frequency. A signal is written as mean + Re(sum of c_k exp(2 pi i k p)) over the position p
[cycles]. The phase of a force relative to its reference is then that of the quotient of their first coefficients.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array

Complex = NDArray[np.complex128]

CHUNK = 2**18
"""Number of samples of a long signal processed at a time."""

STEPS, CONVERGED = 12, 1e-12
"""Maximum number of steps of the four-parameter fit, and the relative change of the frequency at which it ends."""

FIRST_LENGTH, GROWTH = 8.0, 4.0
"""Number of cycles in the first fit of the frequency, and its growth factor from fit to fit. A frequency error of more than
about half a cycle over the length of the signal leads to a wrong minimum."""


class Harmonics(NamedTuple):
    """A fit of several signals with the same samples.

    Attributes:
        mean: constant parts, shape (signals,).
        coefficient: coefficients of the harmonics, shape (signals, harmonics).
        fitted: the fitted signals, shape (n, signals).
        variance: variance of each signal's residual, shape (signals,); NaN without degrees of freedom.
    """

    mean: Array
    coefficient: Complex
    fitted: Array
    variance: Array


def basis(position: Array, harmonics: int) -> Array:
    """Return the columns of the fit: 1, then cosine and sine of each harmonic.

    Args:
        position: place in the cycle, shape (n,) [cycles].
        harmonics: number of harmonics.

    Returns:
        Shape (n, 2 harmonics + 1).
    """
    turns = np.exp(2j * np.pi * position)
    columns = np.empty((len(position), 2 * harmonics + 1))
    columns[:, 0] = 1.0
    power = np.ones_like(turns)
    for order in range(1, harmonics + 1):
        power = power * turns
        columns[:, 2 * order - 1], columns[:, 2 * order] = power.real, power.imag
    return columns


class Columns(NamedTuple):
    """Precomputed columns for the fit of mean and harmonics of a known frequency at given samples.

    Attributes:
        harmonics: number of harmonics; 1 is the three-parameter fit of IEEE Std 1057.
        values: the columns of :func:`basis`, followed by a straight line if there is drift, shape (n, terms).
        inverse: inverse of the matrix of the normal equations, shape (terms, terms).
    """

    harmonics: int
    values: Array
    inverse: Array

    @classmethod
    def at(cls, position: Array, harmonics: int, *, drifting: bool = False) -> "Columns":
        """Return the columns of a cycle.

        Args:
            position: place in the cycle, shape (n,) [cycles], over about one cycle.
            harmonics: number of harmonics.
            drifting: whether to fit a straight line as well, which would otherwise appear as harmonics.
        """
        values = basis(position, harmonics)
        if drifting:
            values = np.column_stack([values, position - position.mean()])
        inverse: Array = np.linalg.pinv(values.T @ values, hermitian=True).astype(np.float64, copy=False)
        return cls(harmonics, values, inverse)

    def fit(self, signals: Array) -> Harmonics:
        """Fit signals by linear least squares.

        Args:
            signals: shape (n, signals), finite.
        """
        solution = self.inverse @ (self.values.T @ signals)
        fitted = self.values @ solution
        freedom = self.values.shape[0] - self.values.shape[1]
        squares = ((signals - fitted) ** 2).sum(axis=0)
        last = 2 * self.harmonics
        return Harmonics(
            mean=solution[0],
            coefficient=(solution[1:last:2] - 1j * solution[2 : last + 1 : 2]).T,
            fitted=fitted,
            variance=squares / freedom if freedom > 0 else np.full(signals.shape[1], np.nan),
        )


class Sine(NamedTuple):
    """A sine of the form mean + Re(coefficient exp(2 pi i frequency t)), with t from the first sample.

    Attributes:
        frequency: frequency [Hz].
        coefficient: complex amplitude in the signal's unit.
        mean: mean in the signal's unit.
    """

    frequency: float
    coefficient: complex
    mean: float


def fit_sine(time: Array, signal: Array, frequency: float) -> Sine:
    """Fit a sine and its frequency by the four-parameter method of IEEE Std 1057, over increasingly long parts of the signal.

    Args:
        time: shape (n,) [s], increasing.
        signal: shape (n,), finite.
        frequency: initial value of the search [Hz].
    """
    since = time - time[0]
    length = FIRST_LENGTH / frequency
    found = Sine(frequency, 0j, 0.0)
    while True:
        part = int(np.searchsorted(since, length, side="right"))
        found = _four_parameters(since[:part], signal[:part], found.frequency)
        if part == len(since):
            return found
        length *= GROWTH


def _four_parameters(time: Array, signal: Array, frequency: float) -> Sine:
    """Repeat the linear fit with the frequency correction as fourth parameter until convergence."""
    omega = 2.0 * np.pi * frequency
    cosine = sine = mean = 0.0
    for step in range(STEPS):
        # The first step is the three-parameter fit, required for the derivative with respect to the frequency.
        terms = 3 if step == 0 else 4
        matrix, right = np.zeros((terms, terms)), np.zeros(terms)
        for begin in range(0, len(time), CHUNK):
            t, y = time[begin : begin + CHUNK], signal[begin : begin + CHUNK]
            columns = [np.cos(omega * t), np.sin(omega * t), np.ones_like(t)]
            if step:
                columns.append(t * (sine * columns[0] - cosine * columns[1]))
            chunk = np.column_stack(columns)
            matrix += chunk.T @ chunk
            right += chunk.T @ y
        # Columns are scaled to one, as that of the derivative grows with the length of the signal.
        size = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
        solution = (scipy.linalg.pinvh(matrix / np.outer(size, size)) @ (right / size)) / size
        cosine, sine, mean = solution[:3]
        if step:
            omega += float(solution[3])
            if abs(solution[3]) <= CONVERGED * abs(omega):
                break
    return Sine(omega / (2.0 * np.pi), complex(cosine, -sine), float(mean))
