"""One fit of everything to the recorded motion: the force balance (3) with the friction elements run along it.

The elements' force depends on its coefficients in a bent way, the rest of the balance in a straight one. So
only the elements' coefficients are searched for (Gauss-Newton with bounds, SciPy); at each trial the straight
part follows by linear least squares (variable projection). Blocks that stay far off are left out.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from ehls_ros.arrays import Array
from ehls_ros.identification.gms_force import MOST_PARTS, elements_force, linear_columns
from ehls_ros.identification.motion import Motion
from ehls_ros.identification.presliding import corrected_turns
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.samples import GAUSS, Mask

STEP = 1e-4
"""Relative step of the numerical derivatives."""

REACH = 4.0
"""How far a logarithm may move from its start: a factor of 55 either way."""

EXPONENTS = (0.1, 4.0)
"""Range of the Stribeck exponent; a rig file takes no larger one."""

FAR = 5.0
"""Standard deviations at which a block is left out."""

ROUNDS = 3
"""Fits in a row, each with the noise and the blocks left out that the one before it showed."""

DOUBT = 2.0
"""Standard deviation of a coefficient's logarithm without any data: within a factor of e^2 of where the search ended.

It keeps what the data say nothing of from blurring what they do say.
"""

MOST_LAGS = 200
"""Longest correlation of residuals that is looked for [blocks]."""


class Layout(NamedTuple):
    """Where the searched vector holds what; all but the weights are logarithms.

    Attributes:
        elements: number of friction elements.
    """

    elements: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the searched coefficients: ``static_rise`` is Fs - Fc, weights are relative to the last one's."""
        numbers = range(1, self.elements + 1)
        return (
            "coulomb_force",
            "static_rise",
            "stribeck_velocity",
            "stribeck_exponent",
            "attraction_rate",
            *(f"element_stiffness_{i}" for i in numbers),
            *(f"element_weight_{i}" for i in numbers[:-1]),
        )

    def pack(self, friction: Friction) -> Array:
        """Return the vector of a friction."""
        weight = np.asarray(friction.element_weight)
        return np.concatenate(
            [
                np.log(
                    [
                        friction.coulomb_force,
                        max(friction.static_force - friction.coulomb_force, 1e-3 * friction.coulomb_force),
                        friction.stribeck_velocity,
                        friction.stribeck_exponent,
                        friction.attraction_rate,
                        *friction.element_stiffness,
                    ]
                ),
                np.log(weight[:-1] / weight[-1]),
            ]
        )

    def unpack(self, z: Array) -> Friction:
        """Return the friction of a vector, without viscous part."""
        coulomb, rise, velocity, exponent, rate, *stiffness = np.exp(z[: 5 + self.elements])
        weight = np.exp(np.append(z[5 + self.elements :], 0.0))
        weight /= weight.sum()
        return Friction(
            coulomb_force=float(coulomb),
            static_force=float(coulomb + rise),
            stribeck_velocity=float(velocity),
            stribeck_exponent=float(exponent),
            viscous_coefficient=0.0,
            element_stiffness=tuple(float(k) for k in stiffness),
            element_weight=tuple(float(a) for a in weight),
            attraction_rate=float(rate),
        )


class JointFit(NamedTuple):
    """What the fit found.

    Attributes:
        layout: of the searched vector.
        z: the whole vector.
        free: names of its coefficients that were searched for.
        linear_names: names of the linear coefficients.
        linear: their values.
        covariance: of the searched coefficients, as in z, and the linear ones together.
        cost: half the sum of squares of the residuals in standard deviations.
        blocks: number of blocks that counted, correlated ones counted once.
        noise: standard deviation of each recording's residuals [N].
        residuals: force not explained, one array a recording [N]; NaN where a block did not count.
    """

    layout: Layout
    z: Array
    free: tuple[str, ...]
    linear_names: tuple[str, ...]
    linear: Array
    covariance: Array
    cost: float
    blocks: float
    noise: tuple[float, ...]
    residuals: tuple[Array, ...]

    @property
    def friction(self) -> Friction:
        """The friction's coefficients without the viscous one."""
        return self.layout.unpack(self.z)


class _Problem:
    """Residuals of all recordings, in standard deviations."""

    def __init__(
        self,
        motions: Sequence[Motion],
        usable: Sequence[Mask],
        noise: Sequence[float],
        layout: Layout,
        linear: Sequence[str],
        z: Array,
        searched: Mask,
    ) -> None:
        self.motions, self.usable, self.noise, self.layout = motions, usable, noise, layout
        self.z, self.searched = z, searched
        self.columns = [linear_columns(m, linear) for m in motions]
        rows = np.concatenate([c[u] / s for c, u, s in zip(self.columns, usable, noise, strict=True)])
        self.rows = rows
        self.q, self.r = np.linalg.qr(rows)

    def whole(self, searched: Array) -> Array:
        """Return the whole vector for a trial of its searched part."""
        z = self.z.copy()
        z[self.searched] = searched
        return z

    def friction(self, searched: Array) -> Friction:
        """Return the friction of a trial."""
        return self.layout.unpack(self.whole(searched))

    def unexplained(self, z: Array) -> Array:
        """Return force less that of the elements, in standard deviations, all usable blocks; ``z`` is the searched part."""
        friction = self.friction(z)
        parts = [
            (m.force - elements_force(m, friction))[u] / s
            for m, u, s in zip(self.motions, self.usable, self.noise, strict=True)
        ]
        return np.concatenate(parts)

    def residuals(self, z: Array) -> Array:
        """Return what is left when the linear part has taken what it can."""
        left = self.unexplained(z)
        projected: Array = left - self.q @ (self.q.T @ left)
        return projected

    def jacobian(self, z: Array, *, projected: bool = True) -> Array:
        """Return the derivatives of the residuals, by forward differences."""
        function = self.residuals if projected else self.unexplained
        base = function(z)
        columns = []
        for i in range(len(z)):
            moved = z.copy()
            moved[i] += STEP
            columns.append((function(moved) - base) / STEP)
        return np.column_stack(columns)

    def linear(self, z: Array) -> Array:
        """Return the linear coefficients."""
        solution: Array = solve_triangular(self.r, self.q.T @ self.unexplained(z))
        return solution


def fit(
    motions: Sequence[Motion],
    usable: Sequence[Mask],
    start: Friction,
    linear_names: Sequence[str],
    *,
    free: Sequence[str],
    turning: bool = False,
    rounds: int = ROUNDS,
) -> JointFit:
    """Fit friction elements and force balance to recordings.

    Args:
        motions: the recordings.
        usable: blocks of each that may count.
        start: where to start; its number of elements is kept.
        linear_names: linear coefficients to fit, of :func:`ehls_ros.identification.gms_force.linear_columns`.
        free: names of the searched coefficients, of :attr:`Layout.names`; the others stay at the start.
        turning: whether the recordings' turns are corrected between two fits.
        rounds: fits in a row.

    Returns:
        The fit.
    """
    layout = Layout(len(start.element_stiffness))
    z = layout.pack(start)
    searched = np.array([name in free for name in layout.names])
    deviations = [max(m.force_noise, 1e-9) for m in motions]
    inflation = [1.0] * len(motions)
    masks = [u & np.isfinite(m.force) for u, m in zip(usable, motions, strict=True)]
    low, high = z[searched] - REACH, z[searched] + REACH
    limits = np.array([EXPONENTS if name == "stribeck_exponent" else (0.0, np.inf) for name in layout.names])[searched]
    with np.errstate(divide="ignore"):
        low, high = np.maximum(low, np.log(limits[:, 0])), np.minimum(high, np.log(limits[:, 1]))
    # A rate faster than a block can show, and than its integration can follow, is all the same.
    fastest = math.log(MOST_PARTS * start.coulomb_force / max(m.period for m in motions))
    rate = np.array(layout.names)[searched] == "attraction_rate"
    high[rate] = np.minimum(high[rate], fastest)
    low[rate] = np.minimum(low[rate], fastest - REACH)
    for turn in range(rounds):
        problem = _Problem(motions, masks, _inflated(deviations, inflation), layout, linear_names, z, searched)
        out = least_squares(
            problem.residuals,
            np.clip(z[searched], low, high),
            jac=problem.jacobian,
            bounds=(low, high),
            x_scale="jac",
            loss="soft_l1" if turn == 0 else "linear",
            f_scale=3.0,
            max_nfev=30 if turn == 0 else 15,
            xtol=1e-6,
            ftol=1e-6,
        )
        z = problem.whole(out.x)
        left = _left_over(problem, out.x)
        deviations = [
            max(GAUSS * float(np.median(np.abs(r[u]))), 0.5 * m.force_noise, 1e-9)
            for r, u, m in zip(left, masks, motions, strict=True)
        ]
        masks = [
            u & np.isfinite(m.force) & (np.abs(r) <= FAR * d)
            for u, m, r, d in zip(usable, motions, left, deviations, strict=True)
        ]
        if turning:
            friction = problem.friction(out.x)
            motions = [
                corrected_turns(m, np.where(u, r, np.nan), friction) for m, u, r in zip(motions, masks, left, strict=True)
            ]
        # Correlated blocks count once: a recording weighs less by its correlation time.
        inflation = [_correlation_time(r / s, u) for r, s, u in zip(left, deviations, masks, strict=True)]
    problem = _Problem(motions, masks, _inflated(deviations, inflation), layout, linear_names, z, searched)
    found = z[searched]
    left = _left_over(problem, found)
    scaled = problem.residuals(found)
    rows = np.column_stack([-problem.jacobian(found, projected=False), problem.rows])
    covariance = _by_stroke(rows, scaled, _strokes(motions, masks), _covariance(rows, len(found)))
    return JointFit(
        layout=layout,
        z=z,
        free=tuple(name for name, is_free in zip(layout.names, searched, strict=True) if is_free),
        linear_names=tuple(linear_names),
        linear=problem.linear(found),
        covariance=covariance,
        cost=0.5 * float(scaled @ scaled),
        blocks=float(sum(u.sum() / t for u, t in zip(masks, inflation, strict=True))),
        noise=tuple(deviations),
        residuals=tuple(np.where(u, r, np.nan) for r, u in zip(left, masks, strict=True)),
    )


def combined(first: JointFit, second: JointFit, first_at: Sequence[int], second_at: Sequence[int]) -> JointFit:
    """Return one fit of two that searched for different coefficients, the second starting from the first.

    Args:
        first: whose linear coefficients are kept.
        second: the other.
        first_at: places of the first fit's recordings among all.
        second_at: places of the second's.
    """
    names = [name for name in first.layout.names if name in {*first.free, *second.free}]
    size = len(names) + len(first.linear_names)
    covariance = np.zeros((size, size))
    for fit, linear in ((first, True), (second, False)):
        where = [names.index(name) for name in fit.free]
        if linear:
            where += range(len(names), size)
        covariance[np.ix_(where, where)] = fit.covariance[: len(where), : len(where)]
    places = {place: (fit, i) for fit, at in ((first, first_at), (second, second_at)) for i, place in enumerate(at)}
    ordered = [places[place] for place in sorted(places)]
    return JointFit(
        layout=second.layout,
        z=second.z,
        free=tuple(names),
        linear_names=first.linear_names,
        linear=first.linear,
        covariance=covariance,
        cost=first.cost + second.cost,
        blocks=first.blocks + second.blocks,
        noise=tuple(fit.noise[i] for fit, i in ordered),
        residuals=tuple(fit.residuals[i] for fit, i in ordered),
    )


def _strokes(motions: Sequence[Motion], masks: Sequence[Mask]) -> Array:
    """Return for each block that counts the number of the stroke it belongs to: a way in one direction."""
    numbers, first = [], 0
    for motion, mask in zip(motions, masks, strict=True):
        stroke = first + motion.strokes
        numbers.append(stroke[mask])
        first = int(stroke[-1]) + 1
    return np.concatenate(numbers)


def _by_stroke(rows: Array, residuals: Array, strokes: Array, covariance: Array) -> Array:
    """Return the covariance that holds however the residuals of one stroke go together.

    What the model lacks pulls a whole stroke one way. So the strokes, not the blocks, count as independent: the
    sandwich of cluster-robust regression (Liang and Zeger 1986).

    Args:
        rows: derivatives of the residuals, shape (n, coefficients).
        residuals: shape (n,).
        strokes: number of each one's stroke, shape (n,).
        covariance: as if all residuals were independent.
    """
    _, index = np.unique(strokes, return_inverse=True)
    count, size = int(index.max()) + 1 if index.size else 0, rows.shape[1]
    if count < 2 * size:
        return covariance
    pulls = np.zeros((count, size))
    np.add.at(pulls, index, rows * residuals[:, np.newaxis])
    robust: Array = covariance @ (pulls.T @ pulls) @ covariance * (count / (count - size))
    return robust


def _inflated(deviations: Sequence[float], inflation: Sequence[float]) -> list[float]:
    return [s * math.sqrt(t) for s, t in zip(deviations, inflation, strict=True)]


def _covariance(jacobian: Array, logarithms: int) -> Array:
    """Return the covariance of the coefficients, the first ones logarithms that nobody doubts by more than :data:`DOUBT`."""
    information = jacobian.T @ jacobian
    diagonal = np.arange(logarithms)
    information[diagonal, diagonal] += 1.0 / DOUBT**2
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / scale[:, np.newaxis] / scale, rcond=1e-13, hermitian=True)
    covariance: Array = inverse / scale[:, np.newaxis] / scale
    return covariance


def _left_over(problem: _Problem, z: Array) -> list[Array]:
    """Return the force not explained in every block of every recording [N]."""
    friction, coefficients = problem.friction(z), problem.linear(z)
    return [
        m.force - elements_force(m, friction) - c @ coefficients for m, c in zip(problem.motions, problem.columns, strict=True)
    ]


def _correlation_time(residuals: Array, mask: Mask) -> float:
    """Return how many blocks on end carry the information of one, at least 1."""
    values = np.where(mask, residuals, 0.0)
    values = values - np.sum(values) / max(1, int(mask.sum())) * mask
    size = 1 << (2 * len(values) - 1).bit_length()

    def correlate(x: Array) -> Array:
        spectrum = np.fft.rfft(x, size)
        out: Array = np.fft.irfft(spectrum * np.conj(spectrum), size)[:MOST_LAGS]
        return out

    pairs = correlate(mask.astype(np.float64))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = correlate(values) / np.where(pairs > 0.5, pairs, np.nan)
    correlation = np.nan_to_num(correlation / correlation[0])
    below = np.flatnonzero(correlation < 2.0 / math.sqrt(max(1, int(mask.sum()))))
    last = int(below[0]) if below.size else len(correlation)
    return float(max(1.0, 1.0 + 2.0 * np.sum(correlation[1:last])))


def least_covariance(fit: JointFit, motions: Sequence[Motion]) -> Array:
    """Return the Cramér-Rao bound of a fit's coefficients, were the force sensor's white noise all there is.

    Args:
        fit: the fit, for its coefficients and the blocks that counted.
        motions: its recordings.
    """
    masks = [np.isfinite(r) for r in fit.residuals]
    searched = np.array([name in fit.free for name in fit.layout.names])
    problem = _Problem(motions, masks, [m.force_noise for m in motions], fit.layout, fit.linear_names, fit.z, searched)
    rows = np.column_stack([-problem.jacobian(fit.z[searched], projected=False), problem.rows])
    return _covariance(rows, int(searched.sum()))
