"""Model discrepancy on healthy recordings, learnt as a function of the stage's signals.

A residual is modelled as a sum of

* errors of the model's coefficients, whose derivatives are given;
* a linear function of each signal, as sensors respond to other quantities;
* a smooth function of each signal, and another of each that is multiplied by the stage's input;
* one function of all signals together; and
* a rest that no function of the signals explains.

The smooth functions are Gaussian processes: away from the recordings, their expectation returns to zero and their variance to
its prior (Kennedy, O'Hagan, Bayesian calibration of computer models, 2001); the linear ones continue. On the recordings, all
functions are orthogonal to the coefficients' derivatives (Plumlee, Bayesian calibration of inexact computer models, 2017), so
that no function can replace a coefficient or vary in its place. Everything here works on plain arrays.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.loss import rms, weights
from ehls_ros.diagnosis.windows import OVERLAP
from ehls_ros.samples import GAUSS, Mask

SECTIONS = 3
"""Sections of an only baseline that stand for recordings when the healthy spread is estimated."""

SPREAD_STEPS = 12
"""Rounds in which the healthy spread is estimated."""

MAX_LEARNT = 9000
"""Most windows of all baselines together that a channel is learnt from."""

SINGLE_CENTRES = 20
"""Most centres of the function of one signal."""

JOINT_CENTRES = 60
"""Most centres of the function of all signals together."""

LARGE = 0.9
"""Quantile of a signal's magnitude at which its linear function has its standard deviation."""

NEGLIGIBLE = 1e-3
"""Fraction below which the scale of a signal, the size of a function, or the variance that its columns miss does not count."""

COLLINEAR = 0.01
"""Relative singular value below which derivatives by coefficients count as the same."""

SHOWS = 10.0
"""Amount of an error of :data:`rules.LEFT_ERROR`, in units of the noise and over all windows together, below which no function
need be orthogonal to it.

Of 23 recordings of healthy rigs, as much or three times as much makes the residuals most likely; one makes a leakage without
change vary by 17 instead of 7 %.
"""

FOLDS = 5
"""Parts in which stretches are held out when the remainder is learnt."""

LEARNING_STEPS = 8
"""Rounds in which sizes and noise of the remainder, and Huber's weights of the windows, are estimated."""

MAX_MEMORY = 40
"""Windows over which the remainder may be correlated, at most, and length of the stretches that are held out.

Longer stretches could hold all rare events.
"""


class Windows(NamedTuple):
    """One channel of one recording, window by window, in units of the channel's largest term.

    Attributes:
        residual: of the model, shape (n,).
        noise: standard deviation due to the sensors, shape (n,).
        terms: derivatives of the residual by the relative changes of the coefficients, shape (n, terms).
        signals: signals on which the residual may depend, shape (n, signals).
        factor: the stage's input, to which errors may be proportional, as friction's are to its direction, shape (n,).
        block: number of the block, shape (n,).
    """

    residual: Array
    noise: Array
    terms: Array
    signals: Array
    factor: Array
    block: NDArray[np.intp]

    def thinned(self, stride: int) -> "Windows":
        """Return each ``stride``-th window."""
        return Windows._make(values[::stride] for values in self)

    def where(self, kept: Mask) -> "Windows":
        """Return some of the windows."""
        return Windows._make(values[kept] for values in self)


def _rms_where_finite(variance: Array) -> float:
    near = np.isfinite(variance)
    return float(np.sqrt(np.mean(variance[near]))) if np.any(near) else 0.0


def joined(recordings: Sequence[Windows]) -> Windows:
    """Return the concatenated windows of several recordings."""
    return Windows(*(np.concatenate(parts) for parts in zip(*recordings, strict=True)))


class Expected(NamedTuple):
    """Expected remainder of a healthy rig in windows of another recording.

    Attributes:
        mean: expected residual, shape (n,).
        directions: factor of its covariance, directions directionsᵀ, shape (n, m).
        variance: additional variance of each window, infinite where nothing can be expected, shape (n,).
    """

    mean: Array
    directions: Array
    variance: Array

    @property
    def deviation(self) -> float:
        """Rms standard deviation where anything can be expected."""
        return _rms_where_finite(np.sum(self.directions**2, axis=1) + self.variance)

    @property
    def rest(self) -> float:
        """The same of what varies from window to window."""
        return _rms_where_finite(self.variance)


class Learnt(NamedTuple):
    """Discrepancy model of one channel, learnt from healthy recordings.

    Attributes:
        windows: of all recordings.
        weight: Huber's, of each window, shape (n,).
        recording: recording, or section of a single one, of each window, shape (n,).
        middle: of each signal, shape (signals,).
        scale: of each signal, shape (signals,).
        sizes: standard deviation of the functions: the smooth and the linear one of each signal, the smooth one of each times
            the input, and that of all, shape (functions,).
        left: standard deviation of the unexplained rest, on held-out stretches.
        together: number of windows with correlated errors.
        error: relative standard deviation of the error that each coefficient may have, shape (terms,).
        fitted: mask of the fitted coefficients; an error of the others is possible but not estimated, shape (terms,).
        varying: covariance of the coefficients from recording to recording, in units of their errors, shape (terms, terms).
        changing: standard deviation of each function from recording to recording, relative to its size, shape (functions,).
        power: mean square of the residual, and of its rest on held-out stretches.
    """

    windows: Windows
    weight: Array
    recording: NDArray[np.intp]
    middle: Array
    scale: Array
    sizes: Array
    left: float
    together: float
    error: Array
    fitted: Mask
    varying: Array
    changing: Array
    power: tuple[float, float]

    @property
    def spread(self) -> Array:
        """Relative standard deviation of each coefficient from recording to recording, shape (terms,)."""
        found: Array = np.sqrt(np.diag(self.varying)) * self.error
        return found

    def expected(self, terms: Array, signals: Array, factor: Array, growth: Array) -> Expected:
        """Return the expected remainder of a healthy rig in other windows.

        Args:
            terms: derivatives of the residual by the coefficients there, shape (n, terms).
            signals: signals there on which the residual may depend, shape (n, signals).
            factor: the stage's input there, shape (n,).
            growth: factor on the uncertainty there relative to the recordings, shape (n,).
        """
        known = len(self.windows.residual)
        warped = self.warped(np.vstack([self.windows.signals, signals]))
        terms = np.vstack([self.windows.terms, terms])
        seen = terms[:, self.fitted] / rms(self.windows.noise)
        features = _features(warped, np.concatenate([self.windows.factor, factor]), seen)
        functions, own = features.sized(self.sizes)
        columns = np.hstack([terms * self.error, functions])
        mean, inverse = self.common(columns[:known], own[:known])
        varying = np.diag(self.changing[features.group] ** 2)
        covariance = inverse + scipy.linalg.block_diag(self.varying, varying)
        here = columns[known:]
        free = here.copy()
        free[:, terms.shape[1] :] *= growth[:, None]
        return Expected(
            mean=here @ mean,
            directions=free @ np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance))),
            variance=growth**2 * (self.left**2 + own[known:]),
        )

    def common(self, columns: Array, own: Array) -> tuple[Array, Array]:
        """Return mean and covariance of the weights common to all recordings, in each of which the coefficients deviate.

        Without these deviations, a coefficient that differs from recording to recording by chance would pass for one that
        follows the oil's temperature.

        Args:
            columns: of the weights, those of the coefficients first, shape (n, m).
            own: variance not covered by them, shape (n,).
        """
        squares, along = np.linalg.eigh(self.varying)
        deviating = columns[:, : len(self.varying)] @ (along * np.sqrt(np.maximum(squares, 0.0)))[:, squares > 0.0]
        parts = [deviating * (self.recording == k)[:, None] for k in np.unique(self.recording)]
        weight = self.weight / self.variance(self.windows, own)
        products = _products(np.hstack([columns, *parts]), self.windows.residual, weight)
        mean, covariance = _posterior([products], self.fitted)
        m = columns.shape[1]
        return mean[:m], covariance[:m, :m]

    def where(self, kept: Mask) -> "Learnt":
        """Return the model with some of the windows only."""
        return self._replace(windows=self.windows.where(kept), weight=self.weight[kept], recording=self.recording[kept])

    def leaving(self, after: Array) -> "Learnt":
        """Return the model with its unexplained rest estimated from the residuals on held-out stretches, shape (n,)."""
        capped = np.minimum(after**2, rules.MAX_SQUARE * (GAUSS * float(np.median(np.abs(after)))) ** 2)
        noise = float(np.mean(self.windows.noise**2))
        left = float(np.sqrt(max(float(np.mean(capped)) - noise, 0.0)))
        return self._replace(left=left, together=_together(after, self.windows.block))

    def variance(self, data: Windows, own: Array) -> Array:
        """Return the variance of windows, inflated for correlated errors, shape (n,).

        Args:
            data: the windows.
            own: variance of the functions not covered by their columns, shape (n,).
        """
        return OVERLAP * data.noise**2 + self.together * (self.left**2 + own)

    def warped(self, signals: Array) -> Array:
        """Return standardised signals with compressed tails, shape (n, signals)."""
        return np.arcsinh((signals - self.middle) / self.scale)


def learn(recordings: Sequence[Windows], default_spread: Array, error: Array, fitted: Mask) -> Learnt:
    """Learn the discrepancy of a model on healthy recordings.

    Args:
        recordings: one channel of each.
        default_spread: relative standard deviation of each coefficient from recording to recording that is always allowed for,
            shape (terms,).
        error: relative standard deviation of the error that each coefficient may have, shape (terms,).
        fitted: mask of the coefficients to fit, shape (terms,).
    """
    data = joined(recordings)
    if len(recordings) > 1:
        recording = np.repeat(np.arange(len(recordings)), [len(r.residual) for r in recordings])
    else:
        recording = data.block * SECTIONS // (int(np.max(data.block)) + 1)
    stride = -(-len(data.residual) // MAX_LEARNT)
    data, recording = data.thinned(stride), recording[::stride]
    middle = np.median(data.signals, axis=0)
    largest = np.maximum(np.max(np.abs(data.signals), axis=0), 1e-300)
    scale = np.maximum(np.median(np.abs(data.signals - middle), axis=0), NEGLIGIBLE * largest)
    count = 3 * data.signals.shape[1] + 1
    size = float(np.sqrt(np.mean(data.residual**2) / count))
    now = Learnt(
        data, np.ones(len(data.residual)), recording, middle, scale, np.full(count, size), size, OVERLAP, error, fitted,
        np.diag((default_spread / error) ** 2), np.full(count, rules.FUNCTION_SPREAD), (count * size**2, count * size**2),
    )  # fmt: skip
    features, y = _features(now.warped(data.signals), data.factor, data.terms[:, fitted] / rms(data.noise)), data.residual
    fold = _folds(len(y))
    members = np.bincount(features.group, minlength=count)
    for _ in range(LEARNING_STEPS):
        functions, own = features.sized(now.sizes)
        columns = np.hstack([data.terms * error, functions])
        variance = now.variance(data, own)
        folds = _by_fold(columns, y, now.weight / variance, fold)
        mean, inverse = _posterior(folds, fitted)
        after = _held_out(columns, y, folds, fitted, fold)
        # A function's initial size counts as one more of its weights, so that none vanishes for lack of data.
        energy = np.bincount(features.group, (mean**2 + np.diag(inverse))[data.terms.shape[1] :], count)
        grown = (energy + (size / now.sizes) ** 2) / (members + 1.0)
        now = now._replace(
            # A function that coefficients replace nearly would be huge to fit what is left, and is so elsewhere: none is
            # larger than the residual itself.
            sizes=np.clip(now.sizes * np.sqrt(grown), NEGLIGIBLE * size, np.sqrt(count) * size),
            power=(float(np.mean(y**2)), float(np.mean(after**2))),
            weight=weights((y - columns @ mean) / np.sqrt(variance)),
        ).leaving(after)
    return _with_spread(now, features, default_spread, len(recordings) == 1)


class _Features(NamedTuple):
    """Functions of the signals in terms of independent standard normal weights.

    Attributes:
        columns: of functions of unit variance, shape (n, m).
        group: the function to which each column belongs, shape (m,).
        own: variance of each function not covered by its columns, shape (n, functions).
    """

    columns: Array
    group: NDArray[np.intp]
    own: Array

    def sized(self, sizes: Array) -> tuple[Array, Array]:
        """Return the columns, and the variance they do not cover, scaled to the functions' standard deviations."""
        return self.columns * sizes[self.group], self.own @ sizes**2


def _features(warped: Array, factor: Array, terms: Array) -> _Features:
    """Return the features of the functions of each signal, of each times the factor, and of all together.

    Args:
        warped: the signals, shape (n, signals).
        factor: the stage's input, shape (n,).
        terms: derivatives by the fitted coefficients in units of the noise, to which the features are orthogonal,
            shape (n, terms).
    """
    single = warped.shape[1]
    smooth = [_kernel_columns(warped[:, g : g + 1], SINGLE_CENTRES) for g in range(single)]
    plain = np.sinh(warped)
    linear = plain / np.maximum(np.quantile(np.abs(plain), LARGE, axis=0), 1e-300)
    made = [*smooth, *((linear[:, g : g + 1], np.zeros(len(linear))) for g in range(single))]
    made += [(part * factor[:, None], rest * factor**2) for part, rest in smooth]
    made.append(_kernel_columns(warped / np.sqrt(max(single, 1)), JOINT_CENTRES))
    group = np.repeat(np.arange(len(made)), [part.shape[1] for part, _ in made])
    columns = np.hstack([part for part, _ in made])
    # Orthogonal to the effect of a temperature that hardly varies, functions would follow its noise.
    size = np.sqrt(np.sum(terms**2, axis=0))
    shows = rules.LEFT_ERROR * size > SHOWS
    scaled = terms[:, shows] / size[shows]
    along = np.linalg.lstsq(scaled, columns, rcond=COLLINEAR)[0]
    return _Features(columns - scaled @ along, group, np.column_stack([rest for _, rest in made]))


def _kernel_columns(inputs: Array, most: int) -> tuple[Array, Array]:
    """Return columns whose products approximate a squared-exponential kernel, and the missing variance.

    A pivoted Cholesky factor: each centre is the point least well described by the previous ones.
    """
    n = len(inputs)
    # Row by row, so that each column is contiguous.
    made = np.zeros((most, n))
    rest = np.ones(n)
    count = 0
    while count < most:
        worst = int(np.argmax(rest))
        if rest[worst] < NEGLIGIBLE:
            break
        distance = np.sum((inputs - inputs[worst]) ** 2, axis=1) / rules.SMOOTH**2
        column = np.exp(-0.5 * distance) - made[:count, worst] @ made[:count]
        made[count] = column / np.sqrt(rest[worst])
        rest = np.maximum(rest - made[count] ** 2, 0.0)
        count += 1
    return made[:count].T, rest


def _folds(windows: int) -> NDArray[np.intp]:
    """Return the fold in which each window is held out, shape (windows,)."""
    return np.arange(windows) // MAX_MEMORY % FOLDS


class _Products(NamedTuple):
    """Weighted products of columns with each other, shape (m, m), and with the residual, shape (m,)."""

    normal: Array
    moment: Array


def _products(columns: Array, y: Array, weight: Array) -> _Products:
    """Return the products over some windows.

    Args:
        columns: of standard normal weights, shape (n, m).
        y: the residual, shape (n,).
        weight: of each window, shape (n,).
    """
    scaled = columns * np.sqrt(weight)[:, None]
    # numpy computes half of a matrix times its own transpose, and copies the other half.
    return _Products(scaled.T @ scaled, columns.T @ (weight * y))


def _by_fold(columns: Array, y: Array, weight: Array, fold: NDArray[np.intp]) -> list[_Products]:
    """Return the products over the windows of each fold."""
    inside = (fold == f for f in range(FOLDS))
    return [_products(columns[own], y[own], weight[own]) for own in inside]


def _solved(folds: Sequence[_Products], fitted: Mask) -> tuple[Array, Array]:
    """Return the mean of standard normal weights given some products, and the inverse of their covariance.

    Only the fitted columns have a mean: those of the fitted coefficients, which come first, and all of the functions.
    """
    moment = np.sum([own.moment for own in folds], axis=0)
    normal = np.sum([own.normal for own in folds], axis=0) + np.eye(len(moment))
    chosen = np.concatenate([fitted, np.ones(len(moment) - len(fitted), dtype=np.bool_)])
    mean = np.zeros(len(moment))
    mean[chosen] = scipy.linalg.cho_solve(scipy.linalg.cho_factor(normal[np.ix_(chosen, chosen)]), moment[chosen])
    return mean, normal


def _posterior(folds: Sequence[_Products], fitted: Mask) -> tuple[Array, Array]:
    """Return mean and covariance of standard normal weights; the mean of unfitted ones is zero."""
    mean, normal = _solved(folds, fitted)
    return mean, scipy.linalg.cho_solve(scipy.linalg.cho_factor(normal), np.eye(len(normal)))


def _held_out(columns: Array, y: Array, folds: Sequence[_Products], fitted: Mask, fold: NDArray[np.intp]) -> Array:
    """Return the residuals of each fold with the weights fitted to the others, shape (n,)."""
    left = y.copy()
    for f in range(FOLDS):
        mean, _ = _solved([own for g, own in enumerate(folds) if g != f], fitted)
        left[fold == f] -= columns[fold == f] @ mean
    return left


def _together(e: Array, block: NDArray[np.intp]) -> float:
    """Return the number of neighbouring windows with correlated errors, from the autocorrelation of residuals."""
    limit = rules.HUBER * GAUSS * float(np.median(np.abs(e)))
    e = np.clip(e, -limit, limit)
    total, power = 1.0, float(np.mean(e * e))
    for lag in range(1, MAX_MEMORY):
        same = block[lag:] == block[:-lag]
        if not np.any(same) or power == 0.0:
            break
        correlation = float(np.mean((e[lag:] * e[:-lag])[same])) / power
        if correlation < rules.UNCORRELATED:
            break
        total += 2.0 * correlation
    return total


def _with_spread(found: Learnt, features: _Features, default_spread: Array, only: bool) -> Learnt:
    """Return the model with the spread of coefficients and functions from recording to recording.

    Coefficients that act nearly alike may replace each other from recording to recording, by much more than their sum varies:
    the spread is that of the combinations of coefficients that act independently of each other.

    Args:
        found: the model learnt from all recordings together.
        features: of its windows.
        default_spread: as for :func:`learn`.
        only: whether the recordings are sections of a single one.
    """
    data, terms = found.windows, found.windows.terms.shape[1]
    functions, own = features.sized(found.sizes)
    columns = np.hstack([data.terms * found.error, functions])
    mean, _ = found.common(columns, own)
    rest = found._replace(windows=data._replace(residual=data.residual - columns @ mean))
    # A coefficient without default spread does not vary.
    least, varies = default_spread / found.error, np.flatnonzero(default_spread)
    turned = np.eye(terms)
    turned[np.ix_(varies, varies)] = np.linalg.eigh(columns[:, varies].T @ columns[:, varies])[1]
    group = np.concatenate([np.arange(terms), terms + features.group])
    default = np.concatenate([_turned(least, turned), np.full(len(found.sizes), rules.FUNCTION_SPREAD)])
    between = _between(rest, np.hstack([columns[:, :terms] @ turned, functions]), own, group, default)
    # No function varies by more than its size, and within one recording no coefficient by more than its (possible) error.
    between[terms:] = np.minimum(between[terms:], 1.0)
    if only:
        possible = np.maximum(np.abs(mean[:terms]), rules.LEFT_ERROR / found.error)
        between[:terms] = np.minimum(between[:terms], _turned(possible, turned))
    # A drift within a single recording is extrapolated to the next one as a random walk.
    beyond = np.maximum(between**2 - default**2, 0.0) * (SECTIONS if only else 1)
    return found._replace(
        varying=np.diag(least**2) + (turned * beyond[:terms]) @ turned.T,
        changing=np.sqrt(default[terms:] ** 2 + beyond[terms:]),
    )


def _turned(deviations: Array, turned: Array) -> Array:
    """Return the standard deviations of combinations of independent weights, the columns of an orthogonal matrix."""
    found: Array = np.sqrt(deviations**2 @ turned**2)
    return found


def _between(rest: Learnt, columns: Array, own: Array, group: NDArray[np.intp], default: Array) -> Array:
    """Return the standard deviation of each group's weights from recording to recording, shape (groups,).

    Maximum-likelihood estimate (MacKay, Bayesian interpolation, 1992, 4.2): squares are divided by the number of
    well-determined weights. Step by step, differences between recordings are removed from the noise.

    Args:
        rest: the learnt model, with residuals relative to the mean weights.
        columns: of all weights, shape (n, m).
        own: variance not covered by the columns, shape (n,).
        group: of each weight, shape (m,).
        default: default where the recordings hold no information; counts as one more weight, shape (groups,).
    """
    data, members = rest.windows, np.unique(rest.recording)
    between, fold = np.where(default > 0.0, 1.0, 0.0), _folds(len(data.residual))
    all_fitted = np.ones(0, dtype=np.bool_)
    for _ in range(SPREAD_STEPS):
        energy, determined = np.zeros(len(default)), np.zeros(len(default))
        after, weight = data.residual.copy(), rest.weight.copy()
        variance = rest.variance(data, own)
        for k in members:
            inside = rest.recording == k
            part, y = columns[inside] * between[group], data.residual[inside]
            folds = _by_fold(part, y, rest.weight[inside] / variance[inside], fold[inside])
            shift, inverse = _posterior(folds, all_fitted)
            after[inside] = _held_out(part, y, folds, all_fitted, fold[inside])
            weight[inside] = weights((y - part @ shift) / np.sqrt(variance[inside]))
            energy += np.bincount(group, shift**2, len(default))
            determined += np.bincount(group, 1.0 - np.diag(inverse), len(default))
        # Fitting the mean to all recordings takes the degrees of freedom of one.
        determined *= max(len(members) - 1, 1) / len(members)
        between = np.sqrt((between**2 * energy + default**2) / (determined + 1.0))
        rest = rest._replace(weight=weight).leaving(after)
    return between
