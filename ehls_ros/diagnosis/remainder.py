"""Remainder of each channel's residual with the named causes: noise, an incident, or an unexplained error."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import mostly_in
from ehls_ros.diagnosis.evidence import Evidence, Residuals, measured_in, noise_power
from ehls_ros.diagnosis.held_out import Assessment
from ehls_ros.diagnosis.hypotheses import Candidate, parts
from ehls_ros.diagnosis.loss import power, rms
from ehls_ros.diagnosis.search import Place, Searched
from ehls_ros.diagnosis.stages import Channel


class Blocks(NamedTuple):
    """Grouping of a channel's windows into blocks.

    Attributes:
        number: block of each window, shape (n,).
        total: number of blocks.
        times: middle of each window, shape (n,) [s].
    """

    number: NDArray[np.intp]
    total: int
    times: Array

    def worst(self, e: Array) -> int:
        """Return the block with the largest whitened residuals."""
        return int(np.argmax(np.bincount(self.number, e * e, self.total)))

    def elsewhere(self, e: Array) -> Array:
        """Return whitened residuals without the block in which they are largest, unless it holds most of them.

        An error of the model recurs. A single occurrence may be an incident, or a reversal hidden in noise, after which the
        friction model's elements differ from the rig's until the next reversal.
        """
        others: Array = e[self.number != self.worst(e)]
        return others if 2 * len(others) >= len(e) else e

    def interval(self, block: int) -> tuple[float, float]:
        """Return the times of the first and the last window in a block [s]."""
        times = self.times[self.number == block]
        return float(times[0]), float(times[-1])


class Relevance(NamedTuple):
    """Thresholds above which a residual significantly exceeds the noise.

    Attributes:
        noise: mean square due to noise.
        rare: square of rare residuals due to noise.
        limit: relevant rms whitened residual beyond the noise.
        clear: mean square that is relevant even if small beside the largest term.
        scatter: multiple of the noise power that noise alone may reach.
        once: whether such a mean square is relevant even if from one block only.
    """

    noise: float
    rare: float
    limit: float
    clear: float = math.inf
    scatter: float = rules.SCATTER
    once: bool = True

    def exceeded(self, e: Array) -> bool:
        """Return whether whitened residuals exceed the noise by a relevant amount."""
        rms = power(e) - self.scatter * self.noise
        # A rare error has a small rms, but is relevant where it acts.
        rare = float(np.quantile(e * e, rules.RARE_QUANTILE)) - self.scatter * self.rare
        return math.sqrt(max(rms, 0.0)) > self.limit or math.sqrt(max(rare, 0.0)) > rules.RARE_FACTOR * self.limit

    def recurs(self, e: Array, blocks: Blocks) -> bool:
        """Return whether the residual exceeds the noise in several blocks, or in one by too much for an incident."""
        elsewhere = blocks.elsewhere(e)
        return self.exceeded(elsewhere) or power(e if self.once else elsewhere) > self.clear


class Remainder(NamedTuple):
    """Remainder of a channel's residual.

    Attributes:
        channel: the channel.
        before, after: rms whitened residual of the given model, and with the causes on held-out data.
        noise: rms due to noise.
        closed: fraction of the removable power that was removed; 1 if there was none.
        exceeded: whether the residual before exceeds the noise by a relevant amount.
        remains: whether the residual after does.
        incident: the only interval in which it does, if there is just one [s].
        explained: whether the causes acting in the channel leave only noise or close most of the error, and none of them
            imitates an effect outside the list.
    """

    channel: Channel
    before: float
    after: float
    noise: float
    closed: float
    exceeded: bool
    remains: bool
    incident: tuple[float, float] | None
    explained: bool

    @property
    def unexplained(self) -> bool:
        """Whether the channel has an error that the causes do not explain."""
        return not self.explained or (self.remains and self.closed < rules.CLOSED)

    @property
    def doubtful(self) -> bool:
        """Whether more remains than a correct cause usually leaves because of its inexact form."""
        return self.closed < 1.0 - rules.FORM and self.after > rules.STANDS_OUT * self.noise

    @property
    def excess(self) -> float:
        """Remaining rms in multiples of the noise."""
        return self.after / max(self.noise, 1e-12)


def remainder(
    channel: Channel, before: Array, after: Array, blocks: Blocks, relevance: Relevance, *, changed: bool, imitated: bool
) -> Remainder:
    """Describe the remainder of one channel's residual.

    Args:
        channel: the channel.
        before: whitened residual of the given model, shape (n,).
        after: the same with the causes, on held-out data, shape (n,).
        blocks: grouping of the windows.
        relevance: thresholds of a significant residual.
        changed: whether a cause acts in the channel.
        imitated: whether the causes there only imitate an effect outside the list.
    """
    noise, was, now = relevance.noise, power(before), power(after)
    removable = was - noise
    closed = (was - now) / removable if removable > 0.0 else 1.0
    others = blocks.elsewhere(after)
    remains = relevance.recurs(after, blocks)
    once = not remains and relevance.exceeded(after)
    little = rules.LITTLE * noise
    enough = not changed or was < little or closed >= rules.CLOSED or power(others) < little
    return Remainder(
        channel=channel,
        before=math.sqrt(was),
        after=math.sqrt(now),
        noise=math.sqrt(noise),
        closed=closed,
        exceeded=relevance.recurs(before, blocks),
        remains=remains,
        incident=blocks.interval(blocks.worst(after)) if once else None,
        explained=enough and not imitated,
    )


def remainder_in(evidence: Evidence, best: Assessment, channel: Channel, *, imitated: bool = False) -> Remainder:
    """Describe the remainder of a hypothesis in a channel."""
    return remainder(
        channel,
        evidence.base.values[channel],
        best.held_out.residuals.values[channel],
        blocks_of(evidence, channel),
        relevance_in(evidence, channel, alone=not best.names),
        changed=channel in best.held_out.gain,
        imitated=imitated,
    )


def with_allowances(evidence: Evidence, found: Searched) -> tuple[Evidence, Searched]:
    """Return evidence and search result with all allowances fixed at the best hypothesis' values.

    To be named, a delay or an offset must exceed its allowance, and residuals contain only the excess. Once it is named, the
    whole error without it counts.
    """
    taken = {c: evidence.whole(c, e) - e for c, e in found.best.held_out.residuals.values.items()}

    def full(residuals: Residuals) -> Residuals:
        return residuals._replace(values={c: evidence.whole(c, e) - taken[c] for c, e in residuals.values.items()})

    def in_full(assessed: Assessment) -> Assessment:
        return assessed._replace(held_out=assessed.held_out._replace(residuals=full(assessed.held_out.residuals)))

    places = tuple(Place(in_full(place.without), tuple(in_full(rival) for rival in place.rivals)) for place in found.places)
    return replace(evidence, base=full(evidence.base)), found._replace(places=places)


def remainder_as_noise(evidence: Evidence, left: Mapping[Channel, Array]) -> Evidence:
    """Return the evidence with a hypothesis' remainder counted as noise, channel by channel.

    The sensors' noise is independent from window to window. An error of form repeats whenever the rig revisits an operating
    point: however long the recording, it is worth no more than :data:`rules.FORM_FREEDOMS` independent windows.

    Args:
        evidence: the recording compared with the given model.
        left: held-out residuals of the hypothesis, whitened with the noise floor of the evidence.
    """
    floor, correlation = dict[Channel, Array](), dict[Channel, float]()
    for c in evidence.channels:
        remains, noise = (power(e * evidence.floor[c]) for e in (left[c], evidence.noise[c]))
        beyond = max(0.0, remains - noise)
        repeats = max(1.0, len(left[c]) / rules.FORM_FREEDOMS)
        floor[c] = np.sqrt(evidence.floor[c] ** 2 + beyond)
        # Without noise and remainder, no window depends on another.
        correlation[c] = (noise + repeats * beyond) / (noise + beyond) if noise + beyond > 0.0 else 1.0
    return measured_in(evidence, floor, correlation)


def remainders(evidence: Evidence, found: Searched) -> tuple[Remainder, ...]:
    """Describe the remainder of the causes in each channel."""
    imitated = imitated_channels(evidence, found)
    return tuple(remainder_in(evidence, found.best, c, imitated=c in imitated) for c in evidence.channels)


def blocks_of(evidence: Evidence, channel: Channel) -> Blocks:
    """Return the grouping of a channel's windows."""
    return Blocks(evidence.block[channel], evidence.blocks, evidence.times[channel])


def relevance_in(evidence: Evidence, channel: Channel, *, alone: bool = False) -> Relevance:
    """Return the thresholds of a significant residual in a channel.

    Args:
        evidence: the recording compared with the given model.
        channel: the channel.
        alone: whether no cause is named, so that no inexact form can explain a residual clear of the noise.
    """
    noise = noise_power(evidence, channel)
    typical = rms(evidence.floor[channel])
    size = max(evidence.sizes[channel], 1e-300)
    least = max(rules.RELEVANT_BESIDE, evidence.standard.form_error(channel))
    limit = least * size / typical if typical > 0.0 else math.inf
    scatter = evidence.standard.scatter(len(evidence.floor[channel]) / evidence.correlation.get(channel, 1.0))
    rare = evidence.standard.rare_square(channel, noise)
    clear = scatter * noise + max(rules.CLEAR**2 * noise, limit**2 if least > rules.RELEVANT_BESIDE else 0.0)
    # An error of form may concentrate in one block: friction sticks once, where its elements' state decides.
    once = not evidence.standard.form_is_noise
    return Relevance(noise, rare, limit, clear if alone else math.inf, scatter, once)


def imitated_channels(evidence: Evidence, found: Searched) -> frozenset[Channel]:
    """Return the channels with a remainder in which a cause closes too little or ends at a bound of its range.

    A real cause closes nearly all of the remainder of the others. An effect outside the list is imitated by several on it, each
    removing a part of the previous remainder, or by one stretched beyond its plausible range.
    """
    out = set[Channel]()
    best = found.best.held_out.residuals.values
    for index, place in enumerate(found.places):
        main = mostly_in(found.best, place.without)
        noise = noise_power(evidence, main)
        without, after = power(place.without.held_out.residuals.values[main]), power(best[main])
        if power(blocks_of(evidence, main).elsewhere(best[main])) < rules.LITTLE * noise:
            continue
        candidate, values = found.best.hypothesis[index], found.best.fit.values[parts(found.best.hypothesis)[index]]
        if without - after < rules.CLOSED * (without - noise) or at_a_bound(candidate, values):
            out.add(main)
    return frozenset(out)


def at_a_bound(candidate: Candidate, values: Array) -> bool:
    """Return whether a parameter ended at a bound of its range; zero and its neutral value do not count as bounds."""
    ends = ((values <= candidate.lower) | (values >= candidate.upper)) & (values != 0.0) & (values != candidate.neutral)
    return bool(np.any(ends))
