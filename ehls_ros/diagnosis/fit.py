"""Fit of a hypothesis to a recording."""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Evidence, Residuals, sections
from ehls_ros.diagnosis.hypotheses import Hypothesis, bounds, extended, parts
from ehls_ros.diagnosis.loss import gauss_newton, linear_loss, loss
from ehls_ros.diagnosis.stages import Channel, Comparison
from ehls_ros.physics.rig import Rig

CHANGE = 5.0
"""Least norm of the change in whitened residuals that a difference quotient's step should make."""

CHANGE_FRACTION = 0.03
"""The same as a fraction of the residuals' norm: where friction elements break away early or late, they are rough."""

MAX_COUNTED = 1e6
"""Square at which a whitened residual is cut off in that norm."""

MIN_CHANGE = 0.1
"""Fraction of that change below which the step is enlarged."""

MAX_CHANGE = 5.0
"""Multiple of that change above which the step is shortened."""

STEP_GROWTH = 100.0
"""Largest factor by which a step is enlarged or shortened at once."""

MAX_FIT_STEP = 0.25
"""Longest step, as a fraction of a parameter's range."""

FIRST_STEP = 1e-2
"""First step of a difference quotient, as a fraction of the parameter's value."""

FIRST_STEP_AT_ZERO = 1e-4
"""First step of a parameter that is zero, as a fraction of its range."""

MAX_ITERATIONS = 8
"""Most Gauss-Newton steps of a fit."""

CONVERGED = 0.02
"""Decrease of the loss below which a fit has settled [nat]."""

CONVERGED_FRACTION = 1e-4
"""The same as a fraction of the loss, added to it."""

CONVERGED_EXCESS = 3e-3
"""The same, for a fit whose runs are expensive, as a fraction of the loss beyond noise: details say little then."""

MANY_PARAMETERS = 6
"""Free parameters above which derivatives are updated and not evaluated again after every step.

Origin: fits of about 10 take at most 70 evaluations then, on EMPS, instead of 104 to 191.
"""

MIN_DAMPING = 1e-9
"""Levenberg damping of the first step from fresh derivatives, the least."""

DAMPING_FACTOR = 10.0
"""Factor on the damping from one failed step to the next, and its inverse after a good one."""

DAMPED = 1.0 / DAMPING_FACTOR
"""Levenberg damping tried after an undamped step that does not help."""

MAX_TRIES = 4
"""Most dampings tried for one step of a fit, and most sizes for one step of a difference quotient."""

SHORTENED = 0.3
"""Fraction of the first step that is tried when the full step falls short."""

TRUSTED = 0.5
"""Fraction of its predicted decrease that a step must reach for its derivatives to be updated, not redone."""

MIN_STEP_EFFICIENCY = 0.05
"""Fraction of its predicted decrease below which a step shows that the loss is too rough to go on."""

MIN_STEP_FRACTION = 5e-3
"""Fraction of the loss below which a step's decrease must lie as well for the fit to stop there."""


class Fit(NamedTuple):
    """A hypothesis fitted to a recording.

    Attributes:
        hypothesis: the fitted hypothesis.
        values: its free parameters, shape (p,).
        channels: the channels it changes.
        residuals: whitened, with the hypothesis.
        jacobian: their derivatives in these channels, joined, shape (n, p).
        loss: total over these channels [nats].
        steps: steps of the difference quotients, shape (p,).
        settled: whether the fit has converged.
    """

    hypothesis: Hypothesis
    values: Array
    channels: tuple[Channel, ...]
    residuals: Residuals
    jacobian: Array
    loss: float
    steps: Array
    settled: bool = False

    @property
    def costly(self) -> bool:
        """Whether derivatives are expensive: each needs a simulation of a separate load, or there are many."""
        return len(self.values) > MANY_PARAMETERS or any(c.separates_load for c in self.hypothesis)

    def without(self, index: int) -> "Fit":
        """Return the hypothesis without one cause, to be fitted; residuals and derivatives are still those with the cause."""
        kept = np.ones(len(self.values), dtype=np.bool_)
        kept[parts(self.hypothesis)[index]] = False
        others = tuple(c for i, c in enumerate(self.hypothesis) if i != index)
        return self._replace(hypothesis=others, values=self.values[kept], steps=self.steps[kept])

    def only(self, index: int) -> "Fit":
        """Return one cause alone, to be fitted; residuals and derivatives are still those of all causes."""
        part = parts(self.hypothesis)[index]
        return self._replace(hypothesis=(self.hypothesis[index],), values=self.values[part], steps=self.steps[part])

    def beside(self, cause: "Fit") -> "Fit":
        """Return the hypothesis with one more cause, to be fitted; residuals and derivatives are still those without it."""
        return self._replace(
            hypothesis=(*self.hypothesis, *cause.hypothesis),
            values=np.concatenate([self.values, cause.values]),
            steps=np.concatenate([self.steps, cause.steps]),
        )

    def negligible(self, total: float, windows: int) -> float:
        """Return the decrease below which the fit counts as converged [nats].

        Args:
            total: the loss [nats].
            windows: number of residuals it sums; noise alone costs at most about 1 nat each.
        """
        excess = max(0.0, total - windows) if self.costly else 0.0
        return CONVERGED + CONVERGED_FRACTION * total + CONVERGED_EXCESS * excess


class Start(NamedTuple):
    """Starting point of a fit.

    Attributes:
        fit: a hypothesis with its derivatives.
        trials: parameter values to try first; the fit starts from the best of them.
        promise: decrease of the loss predicted for the first trial [nats].
    """

    fit: Fit
    trials: tuple[Array, ...] = ()
    promise: float = 0.0


class Worker:
    """Evaluation and fitting of hypotheses, one instance per thread."""

    def __init__(self, evidence: Evidence, subset: Evidence | None = None) -> None:
        """Create the comparisons of the thread.

        Args:
            evidence: the recording compared with the given model.
            subset: a few blocks of it, if it is long enough for a selection to save time.
        """
        self.evidence = evidence
        self.subset: Worker | None = None if subset is None else Worker(subset)
        self.comparison: Comparison = evidence.comparison()
        self.noisy = Comparison(evidence.noisy_record, evidence.setup)

    def residuals(self, rig: Rig, known: Residuals | None = None) -> Residuals:
        """Return the whitened residuals of a model, reusing those of another in channels where both must be equal."""
        return self.evidence.residuals(self.comparison, rig, known)

    def linearise(self, hypothesis: Hypothesis, values: Array, steps: Array | None = None) -> Fit:
        """Evaluate a hypothesis and its derivatives without fitting it."""
        residuals = self.residuals(extended(self.evidence.rig, hypothesis, values))
        return self._linearised(hypothesis, values, residuals, steps)

    def linearise_again(self, fit: Fit, values: Array) -> Fit:
        """Evaluate a hypothesis and its derivatives at other values, reusing unchanged results."""
        residuals = self.residuals(extended(self.evidence.rig, fit.hypothesis, values), fit.residuals)
        return self._linearised(fit.hypothesis, values, residuals, fit.steps, fit)

    def closer(self, fit: Fit, values: Array) -> Array:
        """Return starting values closer to the optimum if the last cause separates the load, which makes each run expensive.

        They come from a fit to a few blocks; the other causes have already been fitted to the complete recording.
        """
        hypothesis, rig = fit.hypothesis, self.evidence.rig
        if self.subset is None or not hypothesis[-1].separates_load:
            return values
        found = self.subset.fit(self.subset.linearise(hypothesis, values, fit.steps)).values
        channels = self.evidence.channels
        there, here = (self.residuals(extended(rig, hypothesis, v), fit.residuals).joined(channels) for v in (found, values))
        return found if np.sum(loss(there)) < np.sum(loss(here)) else values

    def first_step(self, start: Start) -> Fit:
        """Return the first trial close to its predicted gain, otherwise the best one; derivatives are not updated."""
        now = best = start.fit
        for values in start.trials:
            residuals = self.residuals(extended(self.evidence.rig, now.hypothesis, values), now.residuals)
            total = float(np.sum(loss(residuals.joined(now.channels))))
            if total < best.loss:
                best = now._replace(values=values, residuals=residuals, loss=total)
            if now.loss - total > TRUSTED * start.promise:
                break
        return best

    def fit(self, start: Fit, iterations: int = MAX_ITERATIONS, fresh: Fit | None = None) -> Fit:
        """Minimise the loss by Gauss-Newton steps with Levenberg's damping, within the parameters' ranges.

        Args:
            start: starting point of the fit.
            iterations: maximum number of steps.
            fresh: point at which the derivatives were evaluated, if not the start.
        """
        evidence = self.evidence
        lower, upper = bounds(start.hypothesis)
        now, damping = start, MIN_DAMPING
        # Expensive derivatives are evaluated again only when the last ones give no further progress.
        fresh = fresh or start
        for iteration in range(iterations):
            e = now.residuals.joined(now.channels)
            gained = False
            promised = -math.inf
            for _ in range(MAX_TRIES):
                step = gauss_newton(now.jacobian, e, damping, now.values, lower, upper)
                useful = self._useful(now, e, np.clip(now.values + step, lower, upper) - now.values)
                if np.any(useful):
                    step = useful
                elif iteration:
                    break
                values = np.clip(now.values + step, lower, upper)
                promised = max(promised, now.loss - linear_loss(e, now.jacobian, values - now.values))
                residuals = self.residuals(extended(evidence.rig, now.hypothesis, values), now.residuals)
                total = float(np.sum(loss(residuals.joined(now.channels))))
                if total < now.loss:
                    gained = True
                    break
                damping = max(DAMPING_FACTOR * damping, DAMPED)
            if not gained:
                if now is fresh:
                    return now._replace(settled=True)
                now, damping = self._refreshed(now, fresh), MIN_DAMPING
                fresh = now
                continue
            decrease = now.loss - total
            damping = max(damping / DAMPING_FACTOR, MIN_DAMPING)
            settled = decrease < now.negligible(total, len(e))
            settled = settled or decrease < min(MIN_STEP_EFFICIENCY * promised, MIN_STEP_FRACTION * total)
            if now.costly and not settled and decrease > TRUSTED * promised:
                now = self._updated(now, values, residuals, total)
                continue
            settled &= now is fresh
            now = fresh = self._refreshed(now._replace(values=values, residuals=residuals), fresh)
            if settled:
                return now._replace(settled=True)
        return now if now is fresh else self._refreshed(now, fresh)

    def _linearised(
        self, hypothesis: Hypothesis, values: Array, residuals: Residuals, steps: Array | None, known: Fit | None = None
    ) -> Fit:
        evidence = self.evidence
        lower, upper = bounds(hypothesis)
        if steps is None:
            span = np.minimum(np.where(np.isfinite(upper - lower), upper - lower, 1.0), 1e12)
            steps = np.where(values != 0.0, FIRST_STEP * np.abs(values), FIRST_STEP_AT_ZERO * span)
        steps = steps.copy()
        # Beyond a bound of what is allowed, residuals grow faster: a fit needs the derivatives on the side to which it moves.
        sides = np.ones(len(values)) if known is None else np.where(values < known.values, -1.0, 1.0)
        norm = float(np.sqrt(sum(np.sum(np.minimum(v * v, MAX_COUNTED)) for v in residuals.values.values())))
        change = max(CHANGE, CHANGE_FRACTION * norm)
        columns, touched = list[Residuals](), set[Channel]()
        for i in range(len(values)):
            column = None if known is None else self._kept_column(known, residuals, i)
            if column is None:
                column, steps[i] = self._column(hypothesis, values, residuals, i, float(steps[i]), float(sides[i]), change)
            columns.append(column)
            touched.update(c for c in evidence.channels if np.any(column.values[c]))
        channels = tuple(c for c in evidence.channels if c in touched or np.any(residuals.values[c] != evidence.base.values[c]))
        jacobian = np.column_stack([column.joined(channels) for column in columns]) if columns else np.empty((0, 0))
        total = float(np.sum(loss(residuals.joined(channels))))
        return Fit(hypothesis, values, channels, residuals, jacobian, total, steps)

    def _column(
        self, hypothesis: Hypothesis, values: Array, residuals: Residuals, index: int, step: float, side: float, enough: float
    ) -> tuple[Residuals, float]:
        """Return the derivatives by one parameter, and the step used, which changes the residuals sufficiently."""
        evidence = self.evidence
        lower, upper = (bound[index] for bound in bounds(hypothesis))
        span = upper - lower
        column, change = dict[Channel, Array](), 0.0
        for _ in range(MAX_TRIES):
            # Not beyond a bound.
            signed = side * step if lower <= values[index] + side * step <= upper else -side * step
            moved = values.copy()
            moved[index] += signed
            other = evidence.residuals(self.comparison, extended(evidence.rig, hypothesis, moved), residuals)
            column = {c: (other.values[c] - residuals.values[c]) / signed for c in evidence.channels}
            with np.errstate(over="ignore", invalid="ignore"):
                change = abs(signed) * float(np.sqrt(sum(np.sum(v * v) for v in column.values())))
            if change < MIN_CHANGE * enough and step < MAX_FIT_STEP * span:
                factor = STEP_GROWTH if change == 0.0 else min(STEP_GROWTH, enough / change)
                step = min(step * factor, MAX_FIT_STEP * span)
            elif change > MAX_CHANGE * enough:
                step *= max(1.0 / STEP_GROWTH, enough / change)
            else:
                break
        if not math.isfinite(change):
            # The model diverges within the step: the derivative in this direction is unknown.
            column = {c: np.zeros_like(v) for c, v in column.items()}
        return Residuals(column), step

    def _kept_column(self, known: Fit, residuals: Residuals, index: int) -> Residuals | None:
        """Return the known derivatives by a parameter if the dependencies of the channels it changes are unchanged."""
        here = sections(self.evidence.block, known.channels)
        if known.jacobian.shape != (sum(len(self.evidence.block[c]) for c in known.channels), len(known.values)):
            return None
        column = {c: known.jacobian[rows, index] for c, rows in here.items()}
        moved = [c for c, values in column.items() if np.any(values)]
        if not moved or any(residuals.depends[c] != known.residuals.depends[c] for c in moved):
            return None
        return Residuals({c: column.get(c, np.zeros(len(self.evidence.block[c]))) for c in self.evidence.channels})

    def _useful(self, now: Fit, e: Array, step: Array) -> Array:
        """Return a step without parameters of negligible predicted gain; groups without a common channel settle separately."""
        here = sections(self.evidence.block, now.channels)
        moves = np.array([[np.any(now.jacobian[rows, i]) for rows in here.values()] for i in range(len(step))], dtype=np.bool_)
        out, rest = step.copy(), set(range(len(step)))
        while rest:
            group = {rest.pop()}
            while more := {i for i in rest if np.any(moves[i] & np.any(moves[list(group)], axis=0))}:
                group |= more
                rest -= more
            members = sorted(group)
            rows = np.repeat(np.any(moves[members], axis=0), [part.stop - part.start for part in here.values()])
            before = float(np.sum(loss(e[rows])))
            after = linear_loss(e[rows], now.jacobian[rows][:, members], step[members])
            if before - after < now.negligible(before, int(np.sum(rows))):
                out[members] = 0.0
        return out

    def _refreshed(self, now: Fit, fresh: Fit) -> Fit:
        """Return a fit with its derivatives evaluated again, except those still valid."""
        return self._linearised(now.hypothesis, now.values, now.residuals, fresh.steps, fresh)

    def _updated(self, now: Fit, values: Array, residuals: Residuals, total: float) -> Fit:
        """Return a fit one step further, its derivatives updated to match the observed change.

        Broyden's update, channel by channel (Madsen, Nielsen, Tingleff, Methods for Non-Linear Least Squares Problems, 2004,
        3.5), so that a channel's derivatives by parameters it does not depend on stay zero.
        """
        step = values - now.values
        jacobian = now.jacobian.copy()
        for c, rows in sections(self.evidence.block, now.channels).items():
            size = np.einsum("ni,ni->i", jacobian[rows], jacobian[rows])
            along = size * step
            length = float(along @ step)
            if length > 0.0:
                missed = residuals.values[c] - now.residuals.values[c] - jacobian[rows] @ step
                jacobian[rows] += np.outer(missed, along / length)
        return now._replace(values=values, residuals=residuals, jacobian=jacobian, loss=total)


def newton_start(fit: Fit) -> Start:
    """Return a start that first tries a full Gauss-Newton step and then a shortened one."""
    lower, upper = bounds(fit.hypothesis)
    e = fit.residuals.joined(fit.channels)
    step = gauss_newton(fit.jacobian, e, MIN_DAMPING, fit.values, lower, upper)
    trials = tuple(np.clip(fit.values + part * step, lower, upper) for part in (1.0, SHORTENED))
    return Start(fit, trials, fit.loss - linear_loss(e, fit.jacobian, trials[0] - fit.values))


def base_loss(evidence: Evidence, fit: Fit) -> float:
    """Return the loss of the given model over the channels that a hypothesis changes [nats]."""
    return float(np.sum(loss(evidence.base.joined(fit.channels))))


def predicted_loss(fit: Fit) -> float:
    """Return the loss expected after one Gauss-Newton step [nats]."""
    return fit.loss - newton_start(fit).promise if fit.values.size else fit.loss
