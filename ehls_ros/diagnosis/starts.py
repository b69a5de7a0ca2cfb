"""Where fits start: every cause by itself, and beside others."""

from collections.abc import Callable, Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Errors, Evidence, loss, sections
from ehls_ros.diagnosis.fit import Begin, Fit, Worker, base_loss, begin_of, gauss_newton, linear_loss, predicted_loss
from ehls_ros.diagnosis.hypotheses import Candidate, at_lines, bounds, extended
from ehls_ros.diagnosis.judged import Judged
from ehls_ros.diagnosis.pool import Pool
from ehls_ros.diagnosis.stages import Channel

PROMISING = 5.0
"""Predicted gain from which on a hypothesis is fitted [nats]."""

MORE_PROMISING = 1.5
"""How much more another start has to promise than the one that is best by itself."""

MENDED = 0.1
"""Part of what a hypothesis leaves unexplained that another cause has to gain; half of it is enough of a promise."""

REFINED = 5
"""Extensions of each that are fitted."""

LINES = 3
"""Lines of a residual's spectrum from which periodic disturbances start."""

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it all is done."""


class Starts:
    """Where the fits of every cause start, by itself and beside others.

    Attributes:
        alone: each where its fit starts best by itself, with its derivatives.
    """

    def __init__(self, evidence: Evidence, pool: Pool, found: Sequence[Candidate], progress: Progress) -> None:
        """Find the best starts of every cause by itself.

        Args:
            evidence: the recording beside the model as it was given.
            pool: the threads.
            found: the causes to try.
            progress: told how far it is.
        """
        self._evidence, self._pool, self._found = evidence, pool, found
        progress("every cause by itself", 0.0)
        # Of each cause all its starts in few parts of the recording, the best by itself first.
        self._few = [fits for fits in pool.map(_screen, found) if fits]
        progress("every cause by itself", 0.2)
        self._whole = dict[tuple[int, int], Fit | None]()
        self.alone = self._taken([0] * len(self._few))
        progress("every cause by itself", 0.35)

    def beside(self, member: Judged) -> list[Fit]:
        """Return every cause where its fit starts best beside a hypothesis: what that explains may have hidden where."""
        if not member.names:
            return self.alone
        few = self._pool.few

        def without(worker: Worker, judged: Judged) -> Errors:
            model = extended(few.rig, judged.hypothesis, judged.fit.values)
            return (worker.thin or worker).errors(model)

        (left,) = self._pool.map(without, [member])
        chosen = []
        for fits in self._few:
            gains = [_thin_gain(few, left, f) for f in fits] if len(fits) > 1 else [0.0]
            best = int(np.argmax(gains))
            chosen.append(best if gains[best] > MORE_PROMISING * max(gains[0], PROMISING) else 0)
        return self._taken(chosen)

    def extensions(self, member: Judged) -> list[Begin]:
        """Return the starts of a hypothesis with one more cause that promise most beyond it."""
        evidence = self._evidence
        promises = dict[tuple[str, int], tuple[float, Begin]]()
        least = max(PROMISING, 0.5 * MENDED * sum(member.excess(evidence, c) for c in member.held.gain))
        # What the hypothesis still promises by itself is not the added cause's.
        least += member.fit.loss - predicted_loss(member.fit)
        for other in [*self.beside(member), *self._at_lines(member)]:
            (cause,) = other.hypothesis
            if cause.name in member.names or (cause.parts_load and any(c.parts_load for c in member.hypothesis)):
                continue
            gain, begin = _promise(evidence, member.fit, other)
            if gain > max(least, promises[cause.name, cause.number][0] if (cause.name, cause.number) in promises else 0.0):
                promises[cause.name, cause.number] = (gain, begin)
        return [begin for _, begin in sorted(promises.values(), key=lambda item: -item[0])[:REFINED]]

    def _at_lines(self, member: Judged) -> list[Fit]:
        """Return causes of one frequency where a hypothesis leaves lines in the spectrum: what it explains hid them."""
        evidence = self._evidence
        main = main_channel(evidence)
        if not member.names or member.excess(evidence, main) < PROMISING:
            return []
        lines = lines_of(member.fit.errors.values[main], evidence.times(main), LINES)
        begins = [(c, values) for c in at_lines(self._found, evidence.record, evidence.rig, lines) for values in c.starts]
        fits = self._pool.map(lambda worker, begin: worker.start((begin[0],), begin[1]), begins)
        return [f for f in fits if f.channels and np.any(f.jacobian)]

    def _taken(self, chosen: Sequence[int]) -> list[Fit]:
        """Return the chosen starts of the causes with their derivatives on the whole recording."""
        keys = list(enumerate(chosen))
        missing = [key for key in keys if key not in self._whole]
        self._whole.update(zip(missing, self._pool.map(_start, [self._few[i][j] for i, j in missing]), strict=True))
        return [fit for key in keys if (fit := self._whole[key]) is not None]


def _thin_gain(few: Evidence, left: Errors, other: Fit) -> float:
    """Predict what a cause gains beside a hypothesis that stays as it is, both taken as linear [nats].

    Args:
        few: some parts of the recording.
        left: whitened residuals of the hypothesis there.
        other: the cause at one of its starts there.
    """
    before = left.together(other.channels)
    e = before + other.errors.together(other.channels) - few.base.together(other.channels)
    step = gauss_newton(other.jacobian, e, 1e-9, other.values, *bounds(other.hypothesis))
    return float(np.sum(loss(before))) - linear_loss(e, other.jacobian, step)


def _start(worker: Worker, begin: Fit) -> Fit | None:
    """Evaluate a candidate and its derivatives where its fit starts."""
    fit = worker.start(begin.hypothesis, begin.values, begin.steps)
    return fit if fit.channels and np.any(fit.jacobian) else None


def _screen(worker: Worker, candidate: Candidate) -> list[Fit]:
    """Return the starts of a candidate in few parts of the recording, best first; none where it changes nothing there."""
    few = worker.thin or worker
    found = list[tuple[float, Fit]]()
    steps = None
    for values in candidate.starts:
        fit = few.start((candidate,), values, steps)
        steps = fit.steps
        if not fit.channels or not np.any(fit.jacobian):
            continue
        reached = few.first(begin_of(fit)).loss if len(candidate.starts) > 1 else predicted_loss(fit)
        found.append((base_loss(few.evidence, fit) - reached, fit))
    return [fit for _, fit in sorted(found, key=lambda item: -item[0])]


def _promise(evidence: Evidence, fit: Fit, other: Fit) -> tuple[float, Begin]:
    """Predict what one more cause gains, both taken as linear, and where their fit together starts."""
    channels = tuple(c for c in evidence.channels if c in fit.channels or c in other.channels)
    together = sections(evidence.block, channels)
    own, its = sections(evidence.block, fit.channels), sections(evidence.block, other.channels)
    p, q = len(fit.values), len(other.values)
    rows = sum(len(evidence.block[c]) for c in channels)
    e, j = np.empty(rows), np.zeros((rows, p + q))
    for c, here in together.items():
        e[here] = fit.errors.values[c] + other.errors.values[c] - evidence.base.values[c]
        if c in own:
            j[here, :p] = fit.jacobian[own[c]]
        if c in its:
            j[here, p:] = other.jacobian[its[c]]
    hypothesis = (*fit.hypothesis, *other.hypothesis)
    lower, upper = bounds(hypothesis)
    values = np.concatenate([fit.values, other.values])
    moved = np.clip(values + gauss_newton(j, e, 1e-9, values, lower, upper), lower, upper)
    after = linear_loss(e, j, moved - values)
    before = float(np.sum(loss(fit.errors.together(channels))))
    steps = np.concatenate([fit.steps, other.steps])
    # What is linear starts where the step takes both; else the one or the other may have to stay where it was.
    added = np.concatenate([fit.values, moved[p:]])
    begin = Fit(hypothesis, added, channels, fit.errors, j, before, steps)
    return before - after, Begin(begin, (moved, added, values), before - after)


def main_channel(evidence: Evidence) -> Channel:
    """Return the channel in which lines of the spectrum are looked for."""
    return "force" if "force" in evidence.channels else evidence.channels[0]


def lines_of(e: Array, times: Array, count: int) -> Sequence[float]:
    """Return the frequencies of the strongest lines in a residual's spectrum [Hz]."""
    if len(e) < 16:
        return []
    step = float(np.median(np.diff(times)))
    even = np.interp(np.arange(times[0], times[-1], step), times, np.clip(e, -20.0, 20.0))
    even = (even - even.mean()) * np.hanning(len(even))
    padded = 4 * len(even)
    spectrum = np.abs(np.fft.rfft(even, padded)) ** 2
    frequency = np.fft.rfftfreq(padded, step)
    spectrum[frequency < 2.0 / (len(even) * step)] = 0.0
    found = []
    for _ in range(count):
        peak = int(np.argmax(spectrum))
        found.append(float(frequency[peak]))
        spectrum[np.abs(frequency - frequency[peak]) < 3.0 / (len(even) * step)] = 0.0
    return found
