"""Looking for the causes: all effects one by one, then what has to act beside the best of them."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from queue import SimpleQueue
from typing import NamedTuple, TypeVar

import numpy as np

from ehls_ros.diagnosis.evidence import Errors, Evidence, loss, noise_of, noise_power, power, sections
from ehls_ros.diagnosis.fit import (
    Begin,
    Fit,
    Held,
    Worker,
    begin_of,
    gauss_newton,
    held_out,
    inflation_of,
    lines_of,
    predicted_loss,
)
from ehls_ros.diagnosis.hypotheses import Candidate, Hypothesis, at_lines, bounds, extended, parts
from ehls_ros.diagnosis.stages import Channel

NEEDED = 20.0
"""Gain on held-out data that another cause has to bring, beyond the penalty [nats]; noise alone does not reach it."""

RELEVANT = 5e-4
"""Part of a balance's largest term below which a difference matters to nobody, however sure it is."""

SHOWN = 0.5
"""Size of a difference, in that of the noise, below which it may be what the noise floor leaves out, however sure it is."""

SURE = 4.5
"""Standard errors that a cause's surest parameter has to be from its neutral value."""

MENDED = 0.1
"""Part of what is left unexplained that another cause has to gain."""

MATTERS = 1e-3
"""The same where another cause acts in the balance already, whose form need not be quite that of the effect's file."""

CLOSED = 0.95
"""Part of the removable error that a named cause has to close; what closes less is named by nobody."""

ALL_BUT_FORM = 0.999
"""Part of the removable error that causes close which lack nothing but the form an effect has: 3 % of its size."""

SIMPLER = 5e-3
"""Part of a cause's gain that it may lose for another, or another form of it, with fewer parameters."""

PENALTY = 3.0
"""What every parameter of a cause costs [nats]."""

PROMISING = 5.0
"""Predicted gain from which on a hypothesis is fitted [nats]."""

MORE_PROMISING = 1.5
"""How much more another start has to promise than the one that is best by itself."""

BEAM = 3
"""Hypotheses that are carried on to the next number of causes."""

REFINED = 5
"""Extensions of each that are fitted."""

FITTED = 5
"""Hypotheses that are fitted to the end, of those tried together."""

MOST_POLISHED, POLISHED = 3, 25
"""Hypotheses of them that are fitted on if their fit has not settled, and the steps they get."""

REACH = 0.9
"""Part of the best one's gain that a fit which has not settled has to promise to be fitted on."""

REFINED_SINGLES, FITTED_SINGLES = 24, 10
"""Single causes that are tried, and fitted to the end."""

SCREENED_BLOCKS = 8
"""Blocks of the recording from which it is told where fits start."""

MOST_CAUSES = 3
"""Most causes that are looked for together."""

LINES = 3
"""Lines of a residual's spectrum from which periodic disturbances start."""

Item = TypeVar("Item")
Done = TypeVar("Done")

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it all is done."""


class Judged(NamedTuple):
    """A fitted hypothesis and how it does on held-out data."""

    fit: Fit
    held: Held

    @property
    def hypothesis(self) -> Hypothesis:
        """What was fitted."""
        return self.fit.hypothesis

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its causes."""
        return tuple(c.name for c in self.fit.hypothesis)

    def sigmas(self, index: int) -> float:
        """Return how many standard errors a cause's surest parameter is from its neutral value."""
        part = parts(self.hypothesis)[index]
        deviation = np.sqrt(np.maximum(np.diag(self.held.covariance)[part], 1e-300))
        return float(np.max(np.abs(self.fit.values[part] - self.hypothesis[index].neutral) / deviation))

    def score(self, inflation: dict[Channel, float]) -> float:
        """Return the held-out gain less the penalty for parameters [nats].

        Args:
            inflation: by which each channel's losses are divided, the same for all that are compared.
        """
        gain = sum(float(g.sum()) / inflation[c] for c, g in self.held.gain.items())
        return gain - PENALTY * len(self.fit.values)


class Searched(NamedTuple):
    """What a search found.

    Attributes:
        best: the hypothesis that explains most, without causes where none is needed.
        rests: for each of its causes, the best hypothesis that does without it.
        rivals: for each of its causes, the hypotheses with another cause in its place, best first.
        singles: every cause by itself that was fitted, best first.
        screened: every cause where its fit starts, with its derivatives.
        inflation: by which each channel's losses are divided.
    """

    best: Judged
    rests: tuple[Judged, ...]
    rivals: tuple[tuple[Judged, ...], ...]
    singles: tuple[Judged, ...]
    screened: tuple[Fit, ...]
    inflation: dict[Channel, float]


class Pool:
    """Threads, each with its own worker; the kernels run without Python's lock."""

    def __init__(self, evidence: Evidence, threads: int) -> None:
        """Start the threads."""
        ranges = _telling_parts(evidence)
        few = None if ranges is None else Evidence(evidence.record.parts(ranges), evidence.rig, evidence.setup, seed=0)
        self.few = few or evidence
        self._free: SimpleQueue[Worker] = SimpleQueue()
        for _ in range(threads):
            self._free.put(Worker(evidence, few))
        self._executor, self._leaders = ThreadPoolExecutor(threads), ThreadPoolExecutor(threads)

    def map(self, work: Callable[[Worker, Item], Done], items: Sequence[Item]) -> list[Done]:
        """Do the work on every item, in their order."""

        def one(item: Item) -> Done:
            worker = self._free.get()
            try:
                return work(worker, item)
            finally:
                self._free.put(worker)

        return list(self._executor.map(one, items))

    def lead(self, work: Callable[[Item], Done], items: Sequence[Item]) -> list[Done]:
        """Do work that has parts of it mapped on the items side by side, in their order."""
        return list(self._leaders.map(work, items))

    def close(self) -> None:
        """Stop the threads."""
        self._leaders.shutdown()
        self._executor.shutdown()


class Starts:
    """Where the fits of every cause start, by itself and beside others.

    Attributes:
        found: the causes.
        alone: each where its fit starts best by itself, with its derivatives.
    """

    def __init__(self, pool: Pool, found: Sequence[Candidate], progress: Progress) -> None:
        """Find the best starts of every cause by itself."""
        self.found = found
        self._pool = pool
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
    return float(np.sum(loss(before)) - np.sum(loss(e + other.jacobian @ step)))


def search(evidence: Evidence, found: Sequence[Candidate], threads: int, progress: Progress) -> Searched:
    """Find the causes that explain a recording.

    Args:
        evidence: the recording beside the model as it was given.
        found: the causes to try.
        threads: how many to try at once.
        progress: told how far it is.
    """
    pool = Pool(evidence, threads)
    try:
        return _search(evidence, found, pool, progress)
    finally:
        pool.close()


def _search(evidence: Evidence, found: Sequence[Candidate], pool: Pool, progress: Progress) -> Searched:
    starts = Starts(pool, found, progress)
    screened = starts.alone
    fit = _nothing(evidence)
    nothing = Judged(fit, held_out(evidence, fit))
    gains = np.array([_base_loss(evidence, f) - predicted_loss(f) for f in screened])
    order = [int(i) for i in np.argsort(-gains) if gains[i] > PROMISING][:REFINED_SINGLES]
    singles = _fitted(evidence, pool, [begin_of(screened[i]) for i in order], FITTED_SINGLES)
    progress("causes together", 0.55)

    best = nothing
    inflation = _inflation(evidence, [nothing, *singles])
    level = singles
    for count in range(1, MOST_CAUSES + 1):
        inflation = _inflation(evidence, [best, *level])
        ranked = sorted(level, key=lambda j: -j.score(inflation))
        ranked = [j for j in ranked if _needed(evidence, j, best, inflation)]
        if not ranked:
            break
        best = ranked[0]
        beam = _distinct(ranked)[:BEAM]
        if count == MOST_CAUSES:
            break
        begins = [b for member in beam for b in _extensions(evidence, pool, member, starts)]
        level = _fitted(evidence, pool, begins)
        progress("causes together", 0.55 + 0.1 * count)
    best, rests, rivals = _settled(evidence, pool, best, starts, nothing, singles, inflation)
    inflation = _inflation(evidence, [best, *[j for js in rivals for j in js]])
    progress("causes together", 1.0)
    return Searched(best, rests, rivals, tuple(sorted(singles, key=lambda j: -j.score(inflation))), tuple(screened), inflation)


def main_channel(evidence: Evidence) -> Channel:
    """Return the channel in which lines of the spectrum are looked for."""
    return "force" if "force" in evidence.channels else evidence.channels[0]


def _nothing(evidence: Evidence) -> Fit:
    return Fit((), np.empty(0), (), evidence.base, np.empty((0, 0)), 0.0, np.empty(0))


def _base_loss(evidence: Evidence, fit: Fit) -> float:
    return float(np.sum(loss(evidence.base.together(fit.channels))))


def _telling_parts(evidence: Evidence) -> list[tuple[int, int]] | None:
    """Return the blocks in which the given model does worst, and as many spread evenly over the recording."""
    samples, blocks = len(evidence.record.time), evidence.blocks
    if blocks <= 3 * SCREENED_BLOCKS // 2:
        return None
    worst = np.zeros(blocks)
    for c in evidence.channels:
        total = np.bincount(evidence.block[c], weights=loss(evidence.base.values[c]), minlength=blocks)
        worst = np.maximum(worst, total / max(float(total.mean()), 1e-300))
    chosen = {int(b) for b in np.linspace(0, blocks - 1, SCREENED_BLOCKS // 2).round()}
    for b in np.argsort(-worst):
        if len(chosen) >= SCREENED_BLOCKS:
            break
        chosen.add(int(b))
    return [(-(-b * samples // blocks), -(-(b + 1) * samples // blocks)) for b in sorted(chosen)]


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
        found.append((_base_loss(few.evidence, fit) - reached, fit))
    return [fit for _, fit in sorted(found, key=lambda item: -item[0])]


def _gain(evidence: Evidence, fit: Fit) -> float:
    return _base_loss(evidence, fit) - fit.loss


def _fitted(
    evidence: Evidence, pool: Pool, begins: Sequence[Begin], keep: int = FITTED, rival: Judged | None = None
) -> list[Judged]:
    """Fit hypotheses: the first step of each, and to the end those that are best after it.

    Args:
        evidence: the recording beside the model as it was given.
        pool: the threads.
        begins: where the fits start.
        keep: how many are fitted to the end.
        rival: what they have to come near to be fitted on; the best of themselves where nothing is said.
    """

    def go(worker: Worker, pair: tuple[Begin, Fit]) -> Fit:
        begin, after = pair
        if after is not begin.fit and after.costly and not after.hypothesis[-1].parts_load:
            return worker.fit(after, fresh=begin.fit)
        return worker.fit(worker.again(begin.fit, worker.nearer(begin.fit, after.values)))

    def finish(worker: Worker, begin: Fit) -> Judged:
        fit = begin if begin.settled else worker.fit(begin, POLISHED)
        return Judged(fit, held_out(evidence, fit, worker))

    stepped = pool.map(Worker.first, begins)
    order = sorted(range(len(begins)), key=lambda i: -_gain(evidence, stepped[i]))
    gone = pool.map(go, [(begins[i], stepped[i]) for i in order[:keep]])
    gone.sort(key=lambda f: -_gain(evidence, f))
    wanted = REACH * max([_gain(evidence, f) for f in [*gone[:1], *([rival.fit] if rival is not None else [])]], default=0.0)

    def hopeful(fit: Fit) -> bool:
        return _base_loss(evidence, fit) - predicted_loss(fit) >= wanted

    return pool.map(finish, [f._replace(settled=f.settled or i >= MOST_POLISHED or not hopeful(f)) for i, f in enumerate(gone)])


def _inflation(evidence: Evidence, judged: Sequence[Judged]) -> dict[Channel, float]:
    """Return each channel's inflation under the hypothesis that explains the channel best."""
    best = {c: min((j.fit.errors.values[c] for j in judged), key=lambda e: float(np.sum(loss(e)))) for c in evidence.channels}
    return {c: inflation_of(e) for c, e in best.items()}


def _distinct(ranked: Sequence[Judged]) -> list[Judged]:
    """Keep one hypothesis for each set of names, the best."""
    seen, out = set[frozenset[str]](), []
    for judged in ranked:
        names = frozenset(judged.names)
        if names not in seen:
            seen.add(names)
            out.append(judged)
    return out


def _extensions(evidence: Evidence, pool: Pool, member: Judged, starts: Starts) -> list[Begin]:
    """Return the starts of a hypothesis with one more cause that promise most beyond it."""
    promises = dict[tuple[str, int], tuple[float, Begin]]()
    least = max(PROMISING, 0.5 * MENDED * sum(_excess(evidence, member, c) for c in member.held.gain))
    # What the hypothesis still promises by itself is not the added cause's.
    least += member.fit.loss - predicted_loss(member.fit)
    for other in [*starts.beside(member), *_at_lines(evidence, pool, member, starts.found)]:
        (cause,) = other.hypothesis
        if cause.name in member.names or (cause.parts_load and any(c.parts_load for c in member.hypothesis)):
            continue
        gain, begin = _promise(evidence, member.fit, other)
        if gain > max(least, promises[cause.name, cause.number][0] if (cause.name, cause.number) in promises else 0.0):
            promises[cause.name, cause.number] = (gain, begin)
    return [begin for _, begin in sorted(promises.values(), key=lambda item: -item[0])[:REFINED]]


def _at_lines(evidence: Evidence, pool: Pool, member: Judged, found: Sequence[Candidate]) -> list[Fit]:
    """Return causes of one frequency where a hypothesis leaves lines in the spectrum: those of what it explains hid them."""
    main = main_channel(evidence)
    if not member.names or _excess(evidence, member, main) < PROMISING:
        return []
    lines = lines_of(member.fit.errors.values[main], evidence.times(main), LINES)
    begins = [(c, values) for c in at_lines(found, evidence.record, evidence.rig, lines) for values in c.starts]
    fits = pool.map(lambda worker, begin: worker.start((begin[0],), begin[1]), begins)
    return [f for f in fits if f.channels and np.any(f.jacobian)]


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
    after = float(np.sum(loss(e + j @ (moved - values))))
    before = float(np.sum(loss(fit.errors.together(channels))))
    steps = np.concatenate([fit.steps, other.steps])
    # What is linear starts where the step takes both; else the one or the other may have to stay where it was.
    added = np.concatenate([fit.values, moved[p:]])
    begin = Fit(hypothesis, added, channels, fit.errors, j, before, steps)
    return before - after, Begin(begin, (moved, added, values), before - after)


def _settled(
    evidence: Evidence,
    pool: Pool,
    best: Judged,
    starts: Starts,
    nothing: Judged,
    singles: list[Judged],
    inflation: dict[Channel, float],
) -> tuple[Judged, tuple[Judged, ...], tuple[tuple[Judged, ...], ...]]:
    """Try another cause in the place of each, and do without each, until nothing better is found."""
    rests: list[Judged] = []
    rivals: tuple[tuple[Judged, ...], ...] = ()
    # What is left when one cause goes is the same for whatever had taken its place.
    known = dict[frozenset[tuple[str, int]], tuple[Judged, list[Judged]]]({frozenset(): (nothing, singles)})

    def other_places(best: Judged, index: int) -> tuple[Judged, list[Judged]]:
        rest = _without(evidence, pool, best, index, nothing)
        return rest, _fitted(evidence, pool, _extensions(evidence, pool, rest, starts), rival=best)

    for _ in range(4):
        keys = [frozenset((c.name, c.number) for c in best.hypothesis if c is not gone) for gone in best.hypothesis]
        missing = [i for i, key in enumerate(keys) if key not in known]
        known.update(zip([keys[i] for i in missing], pool.lead(partial(other_places, best), missing), strict=True))
        rests = [known[key][0] for key in keys]
        others = [known[key][1] for key in keys]
        rivals = tuple(tuple(sorted(js, key=lambda j: -j.score(inflation))) for js in others)
        inflation = _inflation(evidence, [best, *[j for js in rivals for j in js]])
        simple = _simpler(best, rests, rivals, inflation)
        if simple is not None:
            best = simple
            continue
        better = [rest for rest in rests if not _needed(evidence, best, rest, inflation)]
        better += [js[0] for js in rivals if js and js[0].score(inflation) > best.score(inflation) + 1.0]
        if not better:
            break
        best = max(better, key=lambda j: j.score(inflation))
    return best, tuple(rests), rivals


def _simpler(
    best: Judged, rests: Sequence[Judged], rivals: Sequence[Sequence[Judged]], inflation: dict[Channel, float]
) -> Judged | None:
    """Return the hypothesis with a cause or a form of fewer parameters in a place that is all but as good, if there is one."""
    for index, candidate in enumerate(best.hypothesis):
        whole = best.score(inflation) - rests[index].score(inflation)
        for judged in rivals[index]:
            other = judged.hypothesis[-1]
            behind = best.score(inflation) - judged.score(inflation)
            fewer = len(other.free) < len(candidate.free)
            if fewer and behind < max(NEEDED if other.name == candidate.name else 0.0, SIMPLER * whole):
                return judged
    return None


def _needed(evidence: Evidence, more: Judged, less: Judged, inflation: dict[Channel, float]) -> bool:
    """Tell whether a hypothesis with a cause more is surer than chance allows, and different enough to matter."""
    gain = more.score(inflation) - less.score(inflation)
    further = mostly_in(more, less) in less.fit.channels
    if gain < NEEDED or relevance(evidence, more, less) < (MATTERS if further else RELEVANT):
        return False
    if not further and not shows(evidence, more, less):
        return False
    # A cause that mends little of what is left beside it mends the form of another, not the model.
    left = sum(_excess(evidence, more, c) / inflation[c] for c in more.held.gain)
    if mends_form(evidence, more, less):
        return False
    # What averages the noise away more than it explains is an average, and no cause.
    quieted = more.held.quieted - less.held.quieted
    return gain >= MENDED * left and gain >= quieted and _surest(more, less) >= SURE


def mends_form(evidence: Evidence, more: Judged, less: Judged) -> bool:
    """Tell whether a cause finds little but what the form of the others leaves over, and does not close that either."""
    main = mostly_in(more, less)
    if main not in less.fit.channels:
        return False
    noise, before, after = noise_power(evidence, main), *(power(j.held.errors.values[main]) for j in (less, more))
    little = before - noise < (1.0 - ALL_BUT_FORM) * (power(evidence.base.values[main]) - noise)
    return little and before - after < CLOSED * (before - noise)


def mostly_in(more: Judged, less: Judged) -> Channel:
    """Return the channel in which a hypothesis explains most beyond another."""
    before, after = less.held.errors.values, more.held.errors.values
    return max(after, key=lambda c: float(np.sum(before[c] ** 2 - after[c] ** 2)))


def _excess(evidence: Evidence, judged: Judged, channel: Channel) -> float:
    """Return the loss of a channel beyond what noise makes [nats]."""
    e = judged.fit.errors.values[channel]
    noise = loss(noise_of(evidence, channel))
    return max(0.0, float(np.sum(loss(e)) - 1.5 * np.sum(noise)))


def _surest(more: Judged, less: Judged) -> float:
    """Return how many standard errors a cause's surest parameter is from its neutral value, by the blocks' disagreement."""
    return max((more.sigmas(i) for i, name in enumerate(more.names) if name not in less.names), default=0.0)


def relevance(evidence: Evidence, more: Judged, less: Judged) -> float:
    """Return how far two hypotheses differ, as a part of the largest term of the balance they differ most in."""
    largest = 0.0
    for c in evidence.channels:
        apart = np.abs(more.fit.errors.values[c] - less.fit.errors.values[c]) * evidence.floor[c]
        size = max(evidence.sizes[c], 1e-300)
        # What acts seldom has a small mean; where it acts it counts.
        largest = max(largest, float(np.sqrt(np.mean(apart**2))) / size, float(np.quantile(apart, 0.99)) / 5.0 / size)
    return largest


def shows(evidence: Evidence, more: Judged, less: Judged) -> bool:
    """Tell whether two hypotheses differ by a size that stands beside the noise's."""
    apart = (more.fit.errors.values[c] - less.fit.errors.values[c] for c in evidence.channels)
    return any(float(np.sqrt(np.mean(a * a))) >= SHOWN for a in apart)


def _without(evidence: Evidence, pool: Pool, best: Judged, index: int, nothing: Judged) -> Judged:
    hypothesis = tuple(c for i, c in enumerate(best.hypothesis) if i != index)
    if not hypothesis:
        return nothing
    keep = np.ones(len(best.fit.values), dtype=np.bool_)
    keep[parts(best.hypothesis)[index]] = False
    begin = Fit(hypothesis, best.fit.values[keep], (), best.fit.errors, np.empty((0, 0)), 0.0, best.fit.steps[keep])
    return _fitted(evidence, pool, [Begin(begin)])[0]
