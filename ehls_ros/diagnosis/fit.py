"""Fitting a hypothesis to a recording."""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Errors, Evidence, loss, sections, weights
from ehls_ros.diagnosis.hypotheses import Hypothesis, bounds, extended
from ehls_ros.diagnosis.stages import Channel, Comparison
from ehls_ros.physics.rig import Rig

CHANGE, CHANGE_PART = 5.0, 0.03
"""Change of the whitened residuals that a difference quotient's step makes, as a norm, and as a part of the residuals'.

Large residuals want large steps: where elements break away early or late, the residual is rough on a small scale."""

STEP_TRIES = 5
"""How often a step of a difference quotient is made larger or smaller."""

MOST_ITERATIONS = 8
"""Most Gauss-Newton steps."""

SETTLED, SETTLED_PART, SETTLED_EXCESS = 0.02, 1e-4, 3e-3
"""Decrease of the loss at which a fit has settled [nats], as a part of it, and of a fit that costs as a part of what is not
noise, all added. While much is left that the fit cannot explain, its details say little."""

DAMPED, MOST_TRIES = 0.1, 4
"""Damping of the first step that is tried where an all but undamped one does not help, and how many are tried.

A step is damped ten times as much as the last; less than this leaves it as it is."""

TRUSTED = 0.5
"""Part of what a step promised that has to come for its derivatives to be taken on."""

KEPT, KEPT_PART = 0.05, 5e-3
"""Part of what a step promised, and part of the loss, below both of which a decrease says that the loss is too rough here
for its derivatives to lead further."""


class Fit(NamedTuple):
    """A hypothesis fitted to a recording.

    Attributes:
        hypothesis: what was fitted.
        values: its free parameters.
        channels: the channels it changes.
        errors: whitened residuals with it.
        jacobian: their derivatives by the parameters, for the channels it changes, one after another.
        loss: loss over the channels it changes.
        steps: steps of the difference quotients.
        settled: whether the loss went down no further.
    """

    hypothesis: Hypothesis
    values: Array
    channels: tuple[Channel, ...]
    errors: Errors
    jacobian: Array
    loss: float
    steps: Array
    settled: bool = False

    @property
    def costly(self) -> bool:
        """Whether every derivative takes a run of a moved load."""
        return any(c.parts_load for c in self.hypothesis)

    def little(self, total: float, windows: int) -> float:
        """Return the decrease of a loss at which the fit has settled [nats]; noise makes half a nat a window, or some more."""
        excess = max(0.0, total - windows) if self.costly else 0.0
        return SETTLED + SETTLED_PART * total + SETTLED_EXCESS * excess


class Begin(NamedTuple):
    """Where a fit may start.

    Attributes:
        fit: a hypothesis with its derivatives.
        ways: values to try, the best of which the fit starts from.
        promise: decrease of the loss that the first of them promises [nats].
    """

    fit: Fit
    ways: tuple[Array, ...] = ()
    promise: float = 0.0


class Worker:
    """What one thread needs to evaluate hypotheses."""

    def __init__(self, evidence: Evidence, few: Evidence | None = None) -> None:
        """Give the thread comparisons of its own: with the recording, and with few parts of it, if that is worth while."""
        self.evidence = evidence
        self.thin: Worker | None = None if few is None else Worker(few)
        self.comparison: Comparison = evidence.comparison()
        self.noisy = Comparison(evidence.noisy_record, evidence.setup)

    def errors(self, rig: Rig, known: Errors | None = None) -> Errors:
        """Return whitened residuals of a model, those taken over that equal another's."""
        return self.evidence.errors(self.comparison, rig, known)

    def start(self, hypothesis: Hypothesis, values: Array, steps: Array | None = None) -> Fit:
        """Evaluate a hypothesis and its derivatives without fitting it."""
        errors = self.errors(extended(self.evidence.rig, hypothesis, values))
        return self._linearised(hypothesis, values, errors, steps)

    def again(self, begin: Fit, values: Array) -> Fit:
        """Evaluate a hypothesis and its derivatives elsewhere, which only takes what changes on the way."""
        errors = self.errors(extended(self.evidence.rig, begin.hypothesis, values), begin.errors)
        return self._linearised(begin.hypothesis, values, errors, begin.steps, begin)

    def nearer(self, begin: Fit, values: Array) -> Array:
        """Return values from which a fit has a shorter way: of a cause added last that moves a load, which costs.

        Few parts of the recording say them; what was there before has been fitted to all of it.
        """
        hypothesis, rig = begin.hypothesis, self.evidence.rig
        if self.thin is None or not hypothesis[-1].parts_load:
            return values
        thin = self.thin.fit(self.thin.start(hypothesis, values, begin.steps)).values
        channels = self.evidence.channels
        there, here = (self.errors(extended(rig, hypothesis, v), begin.errors).together(channels) for v in (thin, values))
        return thin if np.sum(loss(there)) < np.sum(loss(here)) else values

    def _linearised(
        self, hypothesis: Hypothesis, values: Array, errors: Errors, steps: Array | None, known: Fit | None = None
    ) -> Fit:
        evidence, rig = self.evidence, self.evidence.rig
        lower, upper = bounds(hypothesis)
        steps = _first_steps(values, lower, upper) if steps is None else steps.copy()
        wanted = max(CHANGE, CHANGE_PART * float(np.sqrt(sum(np.sum(np.minimum(v * v, 1e6)) for v in errors.values.values()))))
        columns, touched = list[Errors](), set[Channel]()
        for i in range(len(values)):
            same = None if known is None else self._kept_column(known, errors, i)
            if same is not None:
                columns.append(same)
                touched.update(c for c in evidence.channels if np.any(same.values[c]))
                continue
            step = steps[i]
            column: Errors | None = None
            change = 0.0
            for _ in range(STEP_TRIES):
                # Away from the nearer end of the range.
                signed = step if values[i] + step <= upper[i] else -step
                moved = values.copy()
                moved[i] += signed
                other = evidence.errors(self.comparison, extended(rig, hypothesis, moved), errors)
                column = Errors({c: (other.values[c] - errors.values[c]) / signed for c in evidence.channels})
                with np.errstate(over="ignore", invalid="ignore"):
                    change = abs(signed) * float(np.sqrt(sum(np.sum(v * v) for v in column.values.values())))
                if change < 0.1 * wanted and step < 0.2 * (upper[i] - lower[i]):
                    step = min(step * (1e3 if change == 0.0 else min(1e3, wanted / change)), 0.25 * (upper[i] - lower[i]))
                elif change > 5.0 * wanted:
                    step *= max(0.01, wanted / change)
                else:
                    break
            steps[i] = step
            if column is None:
                raise AssertionError
            if not math.isfinite(change):
                # The model diverges a step from here: in that direction nothing is known.
                column = Errors({c: np.zeros_like(v) for c, v in column.values.items()})
            columns.append(column)
            touched.update(c for c in evidence.channels if np.any(column.values[c]))
        channels = tuple(c for c in evidence.channels if c in touched or np.any(errors.values[c] != evidence.base.values[c]))
        jacobian = np.column_stack([column.together(channels) for column in columns]) if columns else np.empty((0, 0))
        total = float(np.sum(loss(errors.together(channels))))
        return Fit(hypothesis, values, channels, errors, jacobian, total, steps)

    def _kept_column(self, known: Fit, errors: Errors, index: int) -> Errors | None:
        """Return the derivatives by a parameter as they were, if nothing has changed that the channels it moves depend on."""
        here = sections(self.evidence.block, known.channels)
        if known.jacobian.shape != (sum(len(self.evidence.block[c]) for c in known.channels), len(known.values)):
            return None
        column = {c: known.jacobian[rows, index] for c, rows in here.items()}
        moved = [c for c, values in column.items() if np.any(values)]
        if not moved or any(errors.depends[c] != known.errors.depends[c] for c in moved):
            return None
        return Errors({c: column.get(c, np.zeros(len(self.evidence.block[c]))) for c in self.evidence.channels})

    def _worth(self, now: Fit, e: Array, step: Array) -> Array:
        """Return a step without what promises nothing: parameters that share no channel with others settle by themselves."""
        here = sections(self.evidence.block, now.channels)
        moves = np.array([[np.any(now.jacobian[rows, i]) for rows in here.values()] for i in range(len(step))], dtype=np.bool_)
        out, left = step.copy(), set(range(len(step)))
        while left:
            group = {left.pop()}
            while more := {i for i in left if np.any(moves[i] & np.any(moves[list(group)], axis=0))}:
                group |= more
                left -= more
            members = sorted(group)
            rows = np.repeat(np.any(moves[members], axis=0), [part.stop - part.start for part in here.values()])
            before = float(np.sum(loss(e[rows])))
            after = linear_loss(e[rows], now.jacobian[rows][:, members], step[members])
            if before - after < now.little(before, int(np.sum(rows))):
                out[members] = 0.0
        return out

    def first(self, begin: Begin) -> Fit:
        """Return the first of the values to try before a fit that keep what was promised, or else the best of them.

        The derivatives stay those at its beginning.
        """
        now = best = begin.fit
        for values in begin.ways:
            errors = self.errors(extended(self.evidence.rig, now.hypothesis, values), now.errors)
            total = float(np.sum(loss(errors.together(now.channels))))
            if total < best.loss:
                best = now._replace(values=values, errors=errors, loss=total)
            if now.loss - total > TRUSTED * begin.promise:
                break
        return best

    def fit(self, begin: Fit, iterations: int = MOST_ITERATIONS, fresh: Fit | None = None) -> Fit:
        """Minimise the loss by Gauss-Newton steps with Levenberg's damping, within the parameters' ranges.

        Args:
            begin: where the fit starts.
            iterations: most steps it takes.
            fresh: where the derivatives are from, if not from there.
        """
        evidence = self.evidence
        lower, upper = bounds(begin.hypothesis)
        now, damping = begin, 1e-6
        # What costs is worked out anew where the last derivatives do not lead further.
        fresh = fresh or begin
        for iteration in range(iterations):
            e = now.errors.together(now.channels)
            gained = False
            promised = -math.inf
            for _ in range(MOST_TRIES):
                step = gauss_newton(now.jacobian, e, damping, now.values, lower, upper)
                worth = self._worth(now, e, np.clip(now.values + step, lower, upper) - now.values)
                if np.any(worth):
                    step = worth
                elif iteration:
                    break
                values = np.clip(now.values + step, lower, upper)
                promised = max(promised, now.loss - linear_loss(e, now.jacobian, values - now.values))
                errors = self.errors(extended(evidence.rig, now.hypothesis, values), now.errors)
                total = float(np.sum(loss(errors.together(now.channels))))
                if total < now.loss:
                    gained = True
                    break
                damping = max(10.0 * damping, DAMPED)
            if not gained:
                if now is fresh:
                    return now._replace(settled=True)
                now, damping = self._refreshed(now, fresh), 1e-6
                fresh = now
                continue
            decrease = now.loss - total
            damping = max(damping / 10.0, 1e-9)
            settled = decrease < now.little(total, len(e)) or decrease < min(KEPT * promised, KEPT_PART * total)
            if now.costly and not settled and decrease > TRUSTED * promised:
                now = self._secant(now, values, errors, total)
                continue
            settled &= now is fresh
            now = fresh = self._refreshed(now._replace(values=values, errors=errors), fresh)
            if settled:
                return now._replace(settled=True)
        return now if now is fresh else self._refreshed(now, fresh)

    def _refreshed(self, now: Fit, fresh: Fit) -> Fit:
        """Return a fit with its derivatives worked out anew, but for those that hold since they last were."""
        return self._linearised(now.hypothesis, now.values, now.errors, fresh.steps, fresh)

    def _secant(self, now: Fit, values: Array, errors: Errors, total: float) -> Fit:
        """Return a fit a step on, with derivatives that agree with what the step changed and else stay as they were.

        Broyden's update, channel by channel (Madsen, Nielsen, Tingleff, Methods for Non-Linear Least Squares Problems, 2004,
        3.5): parameters that a channel does not depend on keep out of it.
        """
        step = values - now.values
        jacobian = now.jacobian.copy()
        for c, rows in sections(self.evidence.block, now.channels).items():
            size = np.einsum("ni,ni->i", jacobian[rows], jacobian[rows])
            along = size * step
            length = float(along @ step)
            if length > 0.0:
                missed = errors.values[c] - now.errors.values[c] - jacobian[rows] @ step
                jacobian[rows] += np.outer(missed, along / length)
        return now._replace(values=values, errors=errors, jacobian=jacobian, loss=total)


def _first_steps(values: Array, lower: Array, upper: Array) -> Array:
    span = np.minimum(np.where(np.isfinite(upper - lower), upper - lower, 1.0), 1e12)
    return np.where(values != 0.0, 1e-2 * np.abs(values), 1e-4 * span)


def gauss_newton(jacobian: Array, e: Array, damping: float, values: Array, lower: Array, upper: Array) -> Array:
    """Return a damped Gauss-Newton step that stays within the ranges; none where the model has diverged."""
    free = np.ones(len(values), dtype=np.bool_)
    step = np.zeros(len(values))
    w = weights(e)
    for _ in range(len(values)):
        j = jacobian[:, free]
        normal, gradient = products(j, w, e)
        if not (np.all(np.isfinite(normal)) and np.all(np.isfinite(gradient))):
            return np.zeros(len(values))
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(scale, scale) + damping * np.eye(len(scale))
        step[:] = 0.0
        step[free] = -np.linalg.lstsq(scaled, gradient / scale, rcond=1e-12)[0] / scale
        # A parameter that would leave its range is held at the end of it.
        out = free & (((values + step < lower) & (values <= lower)) | ((values + step > upper) & (values >= upper)))
        if not np.any(out):
            break
        free &= ~out
        step[out] = 0.0
        if not np.any(free):
            break
    return step


def products(j: Array, w: Array, e: Array) -> tuple[Array, Array]:
    """Return jᵀ w j and jᵀ w e. Long and thin: threads of a matrix library would wait for each other."""
    return np.einsum("ni,n,nj->ij", j, w, j), np.einsum("ni,n,n->i", j, w, e)


def begin_of(fit: Fit) -> Begin:
    """Return the beginning of a fit that first tries a Gauss-Newton step, whole and shortened."""
    lower, upper = bounds(fit.hypothesis)
    e = fit.errors.together(fit.channels)
    step = gauss_newton(fit.jacobian, e, 1e-6, fit.values, lower, upper)
    ways = tuple(np.clip(fit.values + part * step, lower, upper) for part in (1.0, 0.3))
    return Begin(fit, ways, fit.loss - linear_loss(e, fit.jacobian, ways[0] - fit.values))


def base_loss(evidence: Evidence, fit: Fit) -> float:
    """Return the loss of the model as it was given over the channels that a hypothesis changes [nats]."""
    return float(np.sum(loss(evidence.base.together(fit.channels))))


def predicted_loss(fit: Fit) -> float:
    """Return the loss that one Gauss-Newton step is expected to reach."""
    if not fit.values.size:
        return fit.loss
    e = fit.errors.together(fit.channels)
    lower, upper = bounds(fit.hypothesis)
    step = gauss_newton(fit.jacobian, e, 1e-9, fit.values, lower, upper)
    step = np.clip(fit.values + step, lower, upper) - fit.values
    return linear_loss(e, fit.jacobian, step)


def linear_loss(e: Array, jacobian: Array, step: Array) -> float:
    """Return the loss that a step reaches where whitened residuals follow their derivatives [nats]."""
    return float(np.sum(loss(e + jacobian @ step)))
