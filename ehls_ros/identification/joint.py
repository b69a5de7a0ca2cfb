"""Joint fit of a friction model and the force balance (3) to recordings.

The friction force depends on the model's coefficients nonlinearly, the rest of the balance linearly. So only the model's
coefficients are searched for (Gauss-Newton with bounds, SciPy); at each trial the linear ones follow by linear least squares
(variable projection). Blocks with too large residuals are left out.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.duals import Dual
from ehls_ros.identification.balance import Recorded, linear_columns
from ehls_ros.identification.covariance import PRIOR_STD, clustered_covariance, correlation_time
from ehls_ros.identification.friction_run import MAX_TANGENTS
from ehls_ros.identification.motion import Motion
from ehls_ros.samples import GAUSS

REACH = 4.0
"""Largest change of a logarithm from its start, a factor of 55 either way."""

EDGE = 1e-3
"""Distance to the end of its reach, as a fraction of it, within which a coordinate counts as at its limit."""

FAR = 5.0
"""Residual, in standard deviations, beyond which a block is left out."""

ROUNDS = 3
"""Number of successive fits; each uses the noise level of the previous one and omits the blocks that it found too far off."""


class Coordinates(Protocol):
    """Coordinates of the search for the coefficients of a friction model.

    Coordinates are of order 1: logarithms, or multiples of a typical value.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""

    def pack(self, friction: Any) -> Array:
        """Return the coordinates of a friction, shape (len(names),)."""

    def unpack(self, z: Array) -> Any:
        """Return the friction at coordinates ``z``, maybe duals; 0 for a viscous part covered by the linear coefficients."""

    def bounds(self, z: Array, period: float) -> tuple[Array, Array]:
        """Return the lowest and the highest coordinates of a search.

        Args:
            z: starting point of the search.
            period: length of the longest block [s].
        """

    def force(self, motion: Motion, friction: Any) -> Array:
        """Return the mean friction force in each block of a motion, shape (n,) [N]."""

    def slopes(self, motion: Motion, friction: Any) -> Array:
        """Return the derivatives of the force by the tangents of a friction of duals, shape (n, at least tangents) [N]."""


class Start(NamedTuple):
    """Starting point of a search, and its free coordinates.

    Attributes:
        coordinates: of the friction model.
        friction: the model's coefficients to start from.
        free: names of the coordinates that are searched for; the others are held.
    """

    coordinates: Coordinates
    friction: Any
    free: tuple[str, ...]


class JointFit(NamedTuple):
    """Result of a fit.

    Attributes:
        coordinates: of the friction model.
        z: all coordinates, searched for or not.
        free: names of the coordinates that were searched for.
        limited: names of those that ended at a limit of their reach.
        linear_names: names of the linear coefficients.
        linear: their values.
        covariance: of the free coordinates followed by the linear coefficients.
        cost: half the sum of squares of the residuals in standard deviations.
        blocks: effective number of fitted blocks, correlated ones counted once.
        noise: standard deviation of each recording's residuals [N]; NaN for a recording that was not fitted.
        residuals: measured less fitted force, one array for each recording [N]; NaN for a block that was not fitted.
        converged: whether the last search met its convergence criterion.
    """

    coordinates: Coordinates
    z: Array
    free: tuple[str, ...]
    limited: tuple[str, ...]
    linear_names: tuple[str, ...]
    linear: Array
    covariance: Array
    cost: float
    blocks: float
    noise: tuple[float, ...]
    residuals: tuple[Array, ...]
    converged: bool = True

    @property
    def friction(self) -> Any:
        """The fitted friction; 0 for a viscous part covered by the linear coefficients."""
        return self.coordinates.unpack(self.z)


class Problem:
    """Residuals of all recordings, in standard deviations.

    Attributes:
        rows: regressors of the linear coefficients in each usable block, shape (n, linear coefficients).
    """

    def __init__(self, recorded: Recorded, start: Start, z: Array, deviations: Sequence[float]) -> None:
        """Prepare the linear part.

        Args:
            recorded: the recordings.
            start: the coordinates and the free ones of them; its friction is not used.
            z: all coordinates; those not free are held at these values.
            deviations: standard deviation of a residual in each recording [N].
        """
        self._recorded, self._coordinates, self._z, self._deviations = recorded, start.coordinates, z, tuple(deviations)
        self._searched = np.array([name in start.free for name in start.coordinates.names])
        self._columns = [linear_columns(m, recorded.linear) for m in recorded.motions]
        self.rows = self._stacked(self._columns)
        self._q, self._r = np.linalg.qr(self.rows)

    def _stacked(self, values: Sequence[Array]) -> Array:
        usable = zip(values, self._recorded.usable, self._deviations, strict=True)
        return np.concatenate([v[good] / deviation for v, good, deviation in usable])

    def free(self, z: Array) -> Array:
        """Return the free ones of all coordinates."""
        return z[self._searched]

    def complete(self, free: Array) -> Array:
        """Return all coordinates for a trial of the free ones."""
        z = self._z.copy()
        z[self._searched] = free
        return z

    def friction(self, free: Array) -> Any:
        """Return the friction of a trial."""
        return self._coordinates.unpack(self.complete(free))

    def unexplained(self, free: Array) -> Array:
        """Return the measured force less the friction model's, in standard deviations, in all usable blocks."""
        friction = self.friction(free)
        return self._stacked([m.force - self._coordinates.force(m, friction) for m in self._recorded.motions])

    def residuals(self, free: Array) -> Array:
        """Return the residuals with the optimal linear coefficients."""
        total = self.unexplained(free)
        projected: Array = total - self._q @ (self._q.T @ total)
        return projected

    def linear(self, free: Array) -> Array:
        """Return the optimal linear coefficients."""
        solution: Array = scipy.linalg.solve_triangular(self._r, self._q.T @ self.unexplained(free))
        return solution

    def slopes(self, free: Array) -> Array:
        """Return the derivatives of :meth:`unexplained`, shape (n, free coordinates)."""
        z, columns = self.complete(free).tolist(), list[Array]()
        searched = np.flatnonzero(self._searched)
        for first in range(0, len(free), MAX_TANGENTS):
            varied = searched[first : first + MAX_TANGENTS]
            lanes = {int(place): lane for lane, place in enumerate(varied)}
            duals = [Dual(value, {lanes[i]: 1.0} if i in lanes else {}) for i, value in enumerate(z)]
            friction = self._coordinates.unpack(np.array(duals, dtype=np.object_))
            slopes = [self._coordinates.slopes(m, friction)[:, : len(varied)] for m in self._recorded.motions]
            columns.append(-self._stacked(slopes))
        return np.concatenate(columns, axis=1) if columns else np.empty((len(self.rows), 0))

    def jacobian(self, free: Array) -> Array:
        """Return the derivatives of :meth:`residuals`."""
        total = self.slopes(free)
        projected: Array = total - self._q @ (self._q.T @ total)
        return projected

    def design(self, free: Array) -> Array:
        """Return the derivatives of the fitted force by the free coordinates and the linear coefficients [1/deviation]."""
        return np.column_stack([-self.slopes(free), self.rows])

    def forces_left(self, free: Array) -> list[Array]:
        """Return measured less fitted force in every block of every recording, usable or not [N]."""
        friction, coefficients = self.friction(free), self.linear(free)
        return [
            m.force - self._coordinates.force(m, friction) - columns @ coefficients
            for m, columns in zip(self._recorded.motions, self._columns, strict=True)
        ]


Turned = Callable[[Motion, Array, Any], Motion]
"""Correction of a motion's turning points from the residual forces of a fit, shape (n,) [N], and the fitted friction."""


def fit(recorded: Recorded, start: Start, *, turned: Turned | None = None, rounds: int = ROUNDS) -> JointFit:
    """Fit a friction model and the force balance to recordings.

    Args:
        recorded: the recordings.
        start: starting point and free coordinates.
        turned: correction of a motion's turning points between two fits; None: no correction.
        rounds: number of successive fits.

    Returns:
        The fit.
    """
    offered = recorded.usable
    recorded = _finite(recorded)
    z = start.coordinates.pack(start.friction)
    deviations = [max(m.force_noise, 1e-9) for m in recorded.motions]
    inflation = [1.0] * len(recorded.motions)
    problem = Problem(recorded, start, z, deviations)
    low, high = map(problem.free, start.coordinates.bounds(z, max(m.period for m in recorded.motions)))
    began, converged = np.clip(problem.free(z), low, high), True
    for turn in range(rounds):
        problem = Problem(recorded, start, z, _inflated(deviations, inflation))
        out = scipy.optimize.least_squares(
            problem.residuals,
            np.clip(problem.free(z), low, high),
            jac=problem.jacobian,
            bounds=(low, high),
            x_scale="jac",
            loss="soft_l1" if turn == 0 else "linear",
            f_scale=3.0,
            max_nfev=30 if turn == 0 else 15,
            xtol=1e-6,
            ftol=1e-6,
        )
        z, converged = problem.complete(out.x), bool(out.status > 0)
        left = problem.forces_left(out.x)
        deviations = [
            max(GAUSS * float(np.median(np.abs(r[u]))), 0.5 * m.force_noise, 1e-9)
            for r, u, m in zip(left, recorded.usable, recorded.motions, strict=True)
        ]
        near = tuple(u & (np.abs(r) <= FAR * d) for u, r, d in zip(offered, left, deviations, strict=True))
        recorded = _finite(recorded._replace(usable=near))
        if turned is not None:
            friction = problem.friction(out.x)
            motions = tuple(
                turned(m, np.where(u, r, np.nan), friction)
                for m, u, r in zip(recorded.motions, recorded.usable, left, strict=True)
            )
            recorded = recorded._replace(motions=motions)
        # Correlated blocks count once: the weight of a recording is reduced by its correlation time.
        inflation = [correlation_time(r / s, u) for r, s, u in zip(left, deviations, recorded.usable, strict=True)]
    problem = Problem(recorded, start, z, _inflated(deviations, inflation))
    found = problem.free(z)
    left = problem.forces_left(found)
    scaled = problem.residuals(found)
    covariance = clustered_covariance(problem.design(found), scaled, strokes(recorded), len(found))
    free = tuple(name for name in start.coordinates.names if name in start.free)
    return JointFit(
        coordinates=start.coordinates,
        z=z,
        free=free,
        limited=tuple(np.array(free)[np.abs(found - began) >= (1.0 - EDGE) * REACH].tolist()),
        linear_names=recorded.linear,
        linear=problem.linear(found),
        covariance=covariance,
        cost=0.5 * float(scaled @ scaled),
        blocks=float(sum(u.sum() / t for u, t in zip(recorded.usable, inflation, strict=True))),
        noise=tuple(deviations),
        residuals=tuple(np.where(u, r, np.nan) for r, u in zip(left, recorded.usable, strict=True)),
        converged=converged,
    )


def moved_with_held(fit: JointFit, recorded: Recorded) -> Array:
    """Return the sensitivity of the fitted coefficients to the held coordinates, at constant force.

    Args:
        fit: the fit.
        recorded: its recordings.

    Returns:
        Derivatives of the free coordinates and the linear coefficients by the held ones, shape (fitted, held).
    """
    usable = tuple(np.isfinite(residuals) for residuals in fit.residuals)
    everything = Start(fit.coordinates, fit.friction, fit.coordinates.names)
    problem = Problem(recorded._replace(usable=usable), everything, fit.z, fit.noise)
    slopes, searched = problem.slopes(fit.z), np.array([name in fit.free for name in fit.coordinates.names])
    moved, *_ = np.linalg.lstsq(np.column_stack([-slopes[:, searched], problem.rows]), slopes[:, ~searched], rcond=None)
    return np.asarray(moved, dtype=np.float64)


def with_doubt(fit: JointFit, recorded: Recorded) -> JointFit:
    """Return a fit whose covariance includes the prior uncertainty of the coordinates that were held.

    Args:
        fit: the fit.
        recorded: its recordings.
    """
    moved = moved_with_held(fit, recorded)
    return fit._replace(covariance=fit.covariance + PRIOR_STD**2 * moved @ moved.T)


def _finite(recorded: Recorded) -> Recorded:
    usable = tuple(u & np.isfinite(m.force) for u, m in zip(recorded.usable, recorded.motions, strict=True))
    return recorded._replace(usable=usable)


def _inflated(deviations: Sequence[float], inflation: Sequence[float]) -> list[float]:
    return [s * math.sqrt(t) for s, t in zip(deviations, inflation, strict=True)]


def placed(fit: JointFit, at: Sequence[int], motions: Sequence[Motion]) -> JointFit:
    """Return a fit of some recordings as a fit of all, in which the others are not counted.

    Args:
        fit: the fit.
        at: indices of its recordings among all.
        motions: all recordings.
    """
    noise = [math.nan] * len(motions)
    residuals = [np.full(len(m.force), np.nan) for m in motions]
    for i, place in enumerate(at):
        noise[place], residuals[place] = fit.noise[i], fit.residuals[i]
    return fit._replace(noise=tuple(noise), residuals=tuple(residuals))


def combined(first: JointFit, second: JointFit, moved: Array) -> JointFit:
    """Combine two fits that searched for different coordinates, the second starting from the first.

    The second holds the coordinates fitted by the first, so errors of the first propagate to it and enlarge its covariance
    (Murphy and Topel, Journal of Business & Economic Statistics 3, 1985, (15), with independent recordings).

    Args:
        first: the fit whose linear coefficients are kept.
        second: the other fit, of the same recordings; residuals missing in one are taken from the other.
        moved: sensitivity of the second to the coordinates it held, from :func:`moved_with_held`.
    """
    names = [name for name in first.coordinates.names if name in {*first.free, *second.free}]
    size = len(names) + len(first.linear_names)
    of_first = [*(names.index(name) for name in first.free), *range(len(names), size)]
    of_second = [names.index(name) for name in second.free]
    held = [name for name in second.coordinates.names if name not in second.free]
    by_first = np.zeros((len(of_second), len(of_first)))
    for place, name in enumerate(first.free):
        if name in held:
            by_first[:, place] = moved[: len(of_second), held.index(name)]
    shared = by_first @ first.covariance
    covariance = np.zeros((size, size))
    covariance[np.ix_(of_first, of_first)] = first.covariance
    covariance[np.ix_(of_second, of_first)] = shared
    covariance[np.ix_(of_first, of_second)] = shared.T
    covariance[np.ix_(of_second, of_second)] = second.covariance[: len(of_second), : len(of_second)] + shared @ by_first.T
    return second._replace(
        free=tuple(names),
        limited=(*first.limited, *second.limited),
        linear_names=first.linear_names,
        linear=first.linear,
        covariance=covariance,
        cost=first.cost + second.cost,
        blocks=first.blocks + second.blocks,
        noise=tuple(b if math.isnan(a) else a for a, b in zip(first.noise, second.noise, strict=True)),
        residuals=tuple(np.where(np.isnan(a), b, a) for a, b in zip(first.residuals, second.residuals, strict=True)),
        converged=first.converged and second.converged,
    )


def strokes(recorded: Recorded) -> Array:
    """Return the number of the stroke of each usable block, counted through all recordings, shape (blocks,)."""
    numbers, first = [], 0
    for motion, mask in zip(recorded.motions, recorded.usable, strict=True):
        stroke = first + motion.strokes
        numbers.append(stroke[mask])
        first = int(stroke[-1]) + 1
    return np.concatenate(numbers)
