"""Starting points of fits: every cause alone, beside the causes already found, and at spectral lines of the residual."""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, Residuals, sections
from ehls_ros.diagnosis.fit import MIN_DAMPING, Fit, Start, Worker, base_loss, newton_start, predicted_loss
from ehls_ros.diagnosis.held_out import Assessment
from ehls_ros.diagnosis.hypotheses import Candidate, Hypothesis, at_lines, bounds, extended
from ehls_ros.diagnosis.loss import CLIP, gauss_newton, linear_loss, loss
from ehls_ros.diagnosis.pool import Pool, Progress
from ehls_ros.diagnosis.record import LOAD
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.physics.effects import EFFECTS

PROMISING = 5.0
"""Predicted gain above which a hypothesis is fitted [nat]."""

MORE_PROMISING = 1.5
"""Ratio of predicted gains above which another start replaces the one that is best alone."""

FITTED = 5
"""Hypotheses fitted to the end, of those tried together and beside the first of each group, and most rivals of a cause."""

LINES = 3
"""Spectral lines of a residual from which periodic disturbances start."""

LINE_SAMPLES = 16
"""Fewest windows in which spectral lines are looked for."""

LINE_PADDING = 4
"""Zero padding of the spectrum, as a multiple of the signal's length."""

HARMONICS = 7
"""Highest multiple of a sinusoidal load's frequency at which the model errs noticeably; far higher, any line is near one."""

MOSTLY = 0.5
"""Fraction of a signal's power that is left without the frequency of a sinusoidal one, at most."""

LINE_WIDTH = 3.0
"""Half width of the band removed around a line, in multiples of the frequency resolution."""


class Tried(NamedTuple):
    """All starts of every cause, evaluated in a few blocks of a recording.

    Attributes:
        causes: the causes tried.
        few: the evidence from these blocks.
        fits: starts of each cause that changes any residual there, with their derivatives, best first.
    """

    causes: Sequence[Candidate]
    few: Evidence
    fits: Sequence[Sequence[Fit]]


def try_starts(pool: Pool, causes: Sequence[Candidate], progress: Progress = lambda step, fraction: None) -> Tried:
    """Evaluate all starts of every cause in a few blocks of a recording.

    Args:
        pool: the threads.
        causes: the causes to try.
        progress: called with the progress.
    """
    progress("causes one by one", 0.0)
    fits = [fits for fits in pool.map(_screen, causes) if fits]
    progress("causes one by one", 0.2)
    return Tried(causes, pool.few, fits)


class Starts:
    """Starting points for the fits of every cause, alone and beside others.

    Attributes:
        pool: the threads.
        tried: the starts in a few blocks, possibly whitened with another noise floor.
        alone: each cause at its best starting values, with its derivatives.
    """

    def __init__(self, pool: Pool, tried: Tried) -> None:
        """Evaluate the best start of every cause on all blocks."""
        self.pool, self.tried = pool, tried
        self._complete = dict[tuple[int, int], Fit | None]()
        self._lines = dict[tuple[str, int, tuple[float, ...]], Fit | None]()
        self.alone = self._on_all_blocks([0] * len(tried.fits))

    def beside(self, member: Assessment) -> list[Fit]:
        """Return every cause at its best starting values beside a hypothesis, whose error may have masked them."""
        if not member.names:
            return self.alone
        few = self.tried.few

        def remaining(worker: Worker, other: Assessment) -> Residuals:
            model = extended(few.rig, other.hypothesis, other.fit.values)
            return few.residuals((worker.subset or worker).comparison, model)

        (remainder,) = self.pool.map(remaining, [member])
        chosen = []
        for fits in self.tried.fits:
            gains = [_gain_beside(few, remainder, f) for f in fits] if len(fits) > 1 else [0.0]
            best = int(np.argmax(gains))
            chosen.append(best if gains[best] > MORE_PROMISING * max(gains[0], PROMISING) else 0)
        return self._on_all_blocks(chosen)

    def anew(self, member: Assessment) -> list[Start]:
        """Return the most promising starts of a hypothesis with one more cause, each tried in the model it extends.

        A strong cause changes the effect of others: their sum, taken as linear, then says little. Only causes that act
        where the hypothesis leaves more than noise, enough for a further cause to matter, are tried.
        """
        evidence, few = self.pool.evidence, self.tried.few
        remains, least = member.fit.residuals.values, evidence.standard.relevant_beside
        left = {
            c
            for c in evidence.channels
            if member.excess(evidence, c) > PROMISING and evidence.nrmse(c, evidence.whole(c, remains[c])) >= least
        }
        acting = [fits[0].hypothesis[0] for fits in self.tried.fits if left & set(fits[0].channels)]
        causes = [cause for cause in acting if _can_join(cause, member.hypothesis)]
        if not causes:
            return []
        model = extended(evidence.rig, member.hypothesis, member.fit.values)
        whole = replace(evidence, rig=model, base=member.fit.residuals)
        # The few blocks are the same object if all blocks are tried, so that no start is evaluated twice.
        blocks = whole if few is evidence else replace(few, rig=model, base=few.residuals(few.comparison(), model))
        with closing(self.pool.beside(whole, blocks)) as pool:
            fits = Starts(pool, try_starts(pool, causes)).alone
        return self._promising(member, fits, whole.base)

    def extensions(self, member: Assessment, most: float = math.inf) -> list[Start]:
        """Return the most promising starts of a hypothesis with one more cause.

        Args:
            member: the hypothesis.
            most: maximum number of free parameters of that cause.
        """
        others = [other for other in [*self.beside(member), *self._at_lines(member)] if len(other.values) <= most]
        return self._promising(member, others, self.pool.evidence.base)

    def _promising(self, member: Assessment, others: Sequence[Fit], base: Residuals) -> list[Start]:
        """Return the most promising starts of a hypothesis with one of several further causes.

        Args:
            member: the hypothesis.
            others: the causes, each linearised in the same model.
            base: residuals of that model.
        """
        evidence = self.pool.evidence
        promises = dict[tuple[str, int], Start]()
        excess = sum(member.excess(evidence, c) for c in member.held_out.gain)
        least = max(PROMISING, rules.PROMISED_EXCESS * rules.REMOVED_EXCESS * excess)
        # The gain still available to the hypothesis itself is not due to the further cause.
        least += member.fit.loss - predicted_loss(member.fit)
        for other in others:
            (cause,) = other.hypothesis
            if not _can_join(cause, member.hypothesis):
                continue
            start = combined(evidence, member.fit, other, base)
            key = cause.name, cause.number
            if start.promise > max(least, promises[key].promise if key in promises else 0.0):
                promises[key] = start
        ranked = sorted(promises.values(), key=lambda start: -start.promise)
        return [ranked[i] for i in leading([start.fit for start in ranked], FITTED)]

    def _at_lines(self, member: Assessment) -> list[Fit]:
        """Return single-frequency causes at the spectral lines of a hypothesis' residual, which its causes may have masked."""
        evidence = self.pool.evidence
        main = main_channel(evidence.channels)
        if not member.names or member.excess(evidence, main) < PROMISING:
            return []
        lines = lines_left(evidence, member.fit.residuals.values[main])
        found = at_lines(self.tried.causes, evidence.record, evidence.rig, lines)
        starts = {(c.name, c.number, tuple(values)): (c, values) for c in found for values in c.starts}
        missing = [key for key in starts if key not in self._lines]

        def changes(worker: Worker, start: tuple[Candidate, Array]) -> Fit | None:
            return _changing(worker.linearise((start[0],), start[1]))

        self._lines.update(zip(missing, self.pool.map(changes, [starts[key] for key in missing]), strict=True))
        return [fit for key in starts if (fit := self._lines[key]) is not None]

    def _on_all_blocks(self, chosen: Sequence[int]) -> list[Fit]:
        """Return the chosen start of each cause, linearised on the complete recording."""
        keys = list(enumerate(chosen))
        missing = [key for key in keys if key not in self._complete]
        starts = [self.tried.fits[i][j] for i, j in missing]
        # Already known if all blocks were tried.
        fits = starts if self.tried.few is self.pool.evidence else self.pool.map(_linearised, starts)
        self._complete.update(zip(missing, fits, strict=True))
        return [fit for key in keys if (fit := self._complete[key]) is not None]


def leading(ranked: Sequence[Fit], count: int) -> list[int]:
    """Return the indices of the first hypotheses, and of the best with a last cause from each group beyond them.

    Two causes in one stage may explain more than the best pair from two, and each alone less than a cause elsewhere.

    Args:
        ranked: hypotheses, best first.
        count: number of hypotheses regardless of their group.
    """
    groups = [EFFECTS.load(fit.hypothesis[-1].name).GROUP for fit in ranked]
    return [i for i, group in enumerate(groups) if i < count or group not in groups[:i]]


def _can_join(cause: Candidate, hypothesis: Hypothesis) -> bool:
    """Return whether a cause can be one more of a hypothesis: not there yet, and at most one of them separates the load."""
    return not any(cause.name == c.name or (cause.separates_load and c.separates_load) for c in hypothesis)


def _gain_beside(few: Evidence, remainder: Residuals, other: Fit) -> float:
    """Predict the gain of a cause beside a hypothesis held fixed, with both taken as linear [nats].

    Args:
        few: a few blocks of the recording.
        remainder: residuals of the hypothesis there.
        other: the cause at one of its starts there.
    """
    before = remainder.joined(other.channels)
    e = before + other.residuals.joined(other.channels) - few.base.joined(other.channels)
    step = gauss_newton(other.jacobian, e, MIN_DAMPING, other.values, *bounds(other.hypothesis))
    return float(np.sum(loss(before))) - linear_loss(e, other.jacobian, step)


def _linearised(worker: Worker, start: Fit) -> Fit | None:
    """Evaluate a cause and its derivatives at its start; None if it changes nothing."""
    return _changing(worker.linearise(start.hypothesis, start.values, start.steps))


def _changing(fit: Fit) -> Fit | None:
    return fit if fit.channels and np.any(fit.jacobian) else None


def _screen(worker: Worker, candidate: Candidate) -> list[Fit]:
    """Return the effective starts of a candidate in a few blocks of the recording, best first."""
    few = worker.subset or worker
    found = list[tuple[float, Fit]]()
    steps = None
    for values in candidate.starts:
        fit = few.linearise((candidate,), values, steps)
        steps = fit.steps
        if _changing(fit) is None:
            continue
        left = predicted_loss(fit)
        if len(candidate.starts) > 1:
            # A step from far away may end well by chance; what the start predicts is what it is chosen by later.
            left = max(left, few.first_step(newton_start(fit)).loss)
        found.append((base_loss(few.evidence, fit) - left, fit))
    return [fit for _, fit in sorted(found, key=lambda item: -item[0])]


def combined(evidence: Evidence, fit: Fit, other: Fit, base: Residuals | None = None) -> Start:
    """Return the start of a hypothesis with one more cause; its predicted gain takes both as linear.

    Args:
        evidence: the recording compared with the given model.
        fit: the hypothesis, fitted.
        other: the cause alone at its starting values in some model.
        base: residuals of that model; by default of the given one.
    """
    base = base or evidence.base
    channels = tuple(c for c in evidence.channels if c in fit.channels or c in other.channels)
    together = sections(evidence.block, channels)
    own, its = sections(evidence.block, fit.channels), sections(evidence.block, other.channels)
    p, q = len(fit.values), len(other.values)
    rows = sum(len(evidence.block[c]) for c in channels)
    e, j = np.empty(rows), np.zeros((rows, p + q))
    for c, here in together.items():
        e[here] = fit.residuals.values[c] + other.residuals.values[c] - base.values[c]
        if c in own:
            j[here, :p] = fit.jacobian[own[c]]
        if c in its:
            j[here, p:] = other.jacobian[its[c]]
    hypothesis = (*fit.hypothesis, *other.hypothesis)
    lower, upper = bounds(hypothesis)
    values = np.concatenate([fit.values, other.values])
    moved = np.clip(values + gauss_newton(j, e, MIN_DAMPING, values, lower, upper), lower, upper)
    after = linear_loss(e, j, moved - values)
    before = float(np.sum(loss(fit.residuals.joined(channels))))
    steps = np.concatenate([fit.steps, other.steps])
    # A linear problem starts at the end of the step; otherwise one of the two may have to keep its values.
    added = np.concatenate([fit.values, moved[p:]])
    start = Fit(hypothesis, added, channels, fit.residuals, j, before, steps)
    return Start(start, (moved, added, values), before - after)


def main_channel(channels: Sequence[Channel]) -> Channel:
    """Return the channel searched for spectral lines."""
    return "force" if "force" in channels else channels[0]


def lines_left(evidence: Evidence, e: Array) -> tuple[float, ...]:
    """Return the lines in the main channel's residual from which a periodic disturbance may start, strongest first [Hz].

    Beside errors of form, those of the load are left out: the model errs in step with it.

    Args:
        evidence: the recording compared with the given model.
        e: whitened residual of the main channel, shape (n,).
    """
    main = main_channel(evidence.channels)
    times = evidence.times[main]
    lines = spectral_lines(e, times)
    if not lines or not evidence.standard.form_is_noise or LOAD not in evidence.record:
        return lines
    return beside_load(lines, evidence.means(main, evidence.record.values(LOAD)), times)


def beside_load(lines: Sequence[float], load: Array, times: Array) -> tuple[float, ...]:
    """Return the lines that are not among those of a load, nor among the harmonics of a sinusoidal one.

    Args:
        lines: their frequencies [Hz].
        load: the load, shape (n,).
        times: its times, shape (n,) [s].
    """
    spread = float(np.std(load))
    driven = spectral_lines((load - np.mean(load)) / spread, times) if spread > 0.0 else ()
    if driven and _is_sinusoidal(load, times, driven[0]):
        driven += tuple(order * driven[0] for order in range(2, HARMONICS + 1))
    resolution = 1.0 / float(np.ptp(times))
    return tuple(line for line in lines if all(abs(line - of) >= resolution for of in driven))


def _is_sinusoidal(signal: Array, times: Array, frequency: float) -> bool:
    """Return whether one frequency holds most of a signal's power."""
    angle = 2.0 * math.pi * frequency * times
    columns = np.column_stack([np.ones(len(times)), np.cos(angle), np.sin(angle)])
    left = signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]
    return bool(np.var(left) < MOSTLY * np.var(signal))


def spectral_lines(e: Array, times: Array, count: int = LINES) -> tuple[float, ...]:
    """Return the frequencies of the strongest lines in a residual's spectrum, strongest first [Hz].

    Args:
        e: whitened residuals, shape (n,).
        times: their times, shape (n,) [s].
        count: number of lines.
    """
    if len(e) < LINE_SAMPLES:
        return ()
    step = float(np.median(np.diff(times)))
    even = np.interp(np.arange(times[0], times[-1], step), times, np.clip(e, -CLIP, CLIP))
    even = (even - even.mean()) * np.hanning(len(even))
    padded = LINE_PADDING * len(even)
    spectrum = np.abs(np.fft.rfft(even, padded)) ** 2
    frequency = np.fft.rfftfreq(padded, step)
    spectrum[frequency < rules.LINE_PERIODS / (len(even) * step)] = 0.0
    found = []
    for _ in range(count):
        peak = int(np.argmax(spectrum))
        found.append(float(frequency[peak]))
        spectrum[np.abs(frequency - frequency[peak]) < LINE_WIDTH / (len(even) * step)] = 0.0
    return tuple(found)
