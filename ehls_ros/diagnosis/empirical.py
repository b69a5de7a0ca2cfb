"""A term found in the data: where no named cause explains a stage, a formula or a table over the stage's own signals does.

Each place where a term can act has an effect for it (``ehls_ros/physics/effects/empirical_*.py``). Tables whose argument
predicts the remainder on held-out blocks are fitted beside the named causes, as any other hypothesis; the best is offered if it
closes a worthwhile part of the remainder on held-out data, as a formula where one of few parameters does as well. Its numbers
are parameters of the effect, so that simulator, controllers and reports use it like any effect.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache, partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import differences, explains, most_explained, relevance, share_closed
from ehls_ros.diagnosis.evidence import Evidence, sections
from ehls_ros.diagnosis.fit import Fit, Start, Worker
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.hypotheses import Candidate, parts
from ehls_ros.diagnosis.loss import power
from ehls_ros.diagnosis.partial import PartialAnswer
from ehls_ros.diagnosis.pool import Pool
from ehls_ros.diagnosis.reading import Shape, read, read_formula
from ehls_ros.diagnosis.record import COMMAND
from ehls_ros.diagnosis.remainder import remainders, with_allowances
from ehls_ros.diagnosis.result import Term, argument_unit
from ehls_ros.diagnosis.search import Searched, fitted, given_model, inflations
from ehls_ros.diagnosis.stages import CHANNELS, Channel, Stage
from ehls_ros.diagnosis.starts import combined
from ehls_ros.diagnosis.term_formula import SIZES, Formula, Table, formulas, shapes_of, value_of
from ehls_ros.diagnosis.term_proposals import (
    DISPLACEMENT,
    ERROR,
    PLACES,
    SIGNAL_OF,
    TIME_KNOTS,
    Asked,
    Proposal,
    asked_in,
    proposals,
)
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects._table import VALUES
from ehls_ros.schema import declarations

FITTED_ALONE, FITTED_BESIDE = 4, 6
"""Terms that are fitted to the end, of all whose argument predicts the remainder: alone, and beside named causes.

After one step, a term beside causes that together imitate the error leaves less than the right one alone.
"""

PERIOD_RANGE = 0.05
"""Largest relative change of a period from that found first."""

MEMORY_RANGE = 10.0
"""Largest factor between a time constant, or the width of a play, and that found first."""

DEARER = 1.0 / rules.WORTHWHILE**2
"""Factor by which less of the error must remain with a term than with named causes for it to be offered in their place."""

FORMULA_REACH = rules.MAX_EXTRAPOLATION
"""Distance from the middle of the data, in half ranges of theirs, up to which a formula over a signal with a zero goes on.

Origin: as far as a recording is judged by its baselines; of a table, no value beyond the data is known.
"""

SHOWN_POINTS, SLOPE_STEP = 41, 1e-4
"""Points of a formula's picture, and relative step of the difference quotients of its errors."""

MEMORIES = ("direction", "memory", "play")
"""Parameters of a term's direction and memory."""


class Described(NamedTuple):
    """The named causes with a term beside them.

    Attributes:
        best: the hypothesis; the term comes last.
        without: the named causes alone.
        term: the term.
        rivals: hypotheses with another term that explain as much, by that term's name, best first.
    """

    best: Assessment
    without: Assessment
    term: Term
    rivals: Mapping[str, Assessment]


class _Offer(NamedTuple):
    """A term fitted beside named causes.

    Attributes:
        base: the named causes alone.
        more: with the term.
        proposal: the table that the term began as.
    """

    base: Assessment
    more: Assessment
    proposal: Proposal

    @property
    def name(self) -> str:
        """Effect, argument and factor of the term."""
        p = self.proposal
        factor = f" × {_signal(p.effect, p.factor)}" if p.factor else ""
        return f"{p.effect} over {_signal(p.effect, p.argument)}{factor}"


def described(pool: Pool, found: Searched, answer: PartialAnswer | None, stage: Stage) -> Described | None:
    """Return the term that describes what the named causes leave in a stage; None if none closes a worthwhile part.

    Named causes may only imitate the term: it is also sought without each of them, and without all.

    Args:
        pool: the threads.
        found: result of the search for named causes.
        answer: the causes named beside a remainder, if any.
        stage: the stage with the unexplained remainder.
    """
    evidence = pool.evidence
    nothing = given_model(evidence)
    partly = nothing if answer is None else _refitted(evidence, answer.found.best.fit)
    bases = {frozenset(j.names): j for j in (nothing, *(place.without for place in found.places), partly, found.best)}
    inside = asked_about(evidence, stage)
    linearised, begun = dict[tuple[object, ...], list[Fit]](), list[tuple[Assessment, Proposal, Start]]()
    for base in bases.values():
        proposed = {p.key: p for asked in inside for p in proposals(asked, base.held_out.residuals.values[asked.channel])}
        missing = [(key, c) for key, p in proposed.items() if key not in linearised for c in (candidate_of(p), *_sketched(p))]
        for (key, _), fit in zip(missing, pool.map(_linearised, [candidate for _, candidate in missing]), strict=True):
            linearised.setdefault(key, []).extend([] if fit is None else [fit])
        begun += [(base, p, combined(evidence, base.fit, fit)) for key, p in proposed.items() for fit in linearised[key]]
    origin = {id(start.fit.hypothesis): (base, p) for base, p, start in begun}
    alone, beside = ([start for base, _, start in begun if bool(base.names) == named] for named in (False, True))
    offers = [
        _Offer(base, more, p)
        for starts, most in ((alone, FITTED_ALONE), (beside, FITTED_BESIDE))
        for more in (fitted(evidence, pool, starts, most) if starts else [])
        for base, p in [origin[id(more.hypothesis)]]
    ]
    if not offers:
        return None
    equal = [offers[i] for i in _equally_good(evidence, [offer.more for offer in offers], nothing)]
    # Of equally good ones, that with the fewest causes, and of one signal.
    offer = min(equal, key=lambda offer: (len(offer.more.names), not offer.proposal.simple))
    others = {o.name: o.more for o in equal if o.name != offer.name}
    both = [offer]
    if offer.base.names:
        # A named cause beside a table may hold a part of its shape.
        starts = [combined(evidence, nothing.fit, fit) for fit in linearised[offer.proposal.key]]
        both += [_Offer(nothing, j, offer.proposal) for j in fitted(evidence, pool, starts)]
    offer = _simplest(evidence, [_as_formula(pool, o, nothing) for o in both], nothing)
    if answer is not None:
        offer = _beside_answer(evidence, partly, offer)
    scale = inflations(evidence, [offer.more])
    if not explains(evidence, offer.more, offer.base, scale) or not _is_worthwhile(evidence, found, offer, stage):
        return None
    return Described(offer.more, offer.base, _term(evidence, offer), others)


def _refitted(evidence: Evidence, start: Fit) -> Assessment:
    """Return a hypothesis fitted from its values elsewhere, with only the sensors' noise counted as noise."""
    worker = Worker(evidence)
    return assess(evidence, worker.fit(worker.linearise(start.hypothesis, start.values, start.steps)), worker)


def _beside_answer(evidence: Evidence, answer: Assessment, offer: _Offer) -> _Offer:
    """Return a term beside the causes of a partial answer if these act in other channels only; else as offered.

    Where only the sensors' noise counts, errors of form in those channels pass for causes.
    """
    if most_explained(offer.base.held_out.residuals, offer.more.held_out.residuals) in answer.fit.channels:
        return offer
    return _Offer(answer, _refitted(evidence, answer.fit.beside(offer.more.fit.only(-1))), offer.proposal)


def asked_about(evidence: Evidence, stage: Stage) -> list[Asked]:
    """Return the channels of a stage in which terms can act, prepared for proposals."""
    worker = Worker(evidence)
    return [
        asked_in(evidence, channel, cache(partial(_windows, worker, channel)))
        for channel in evidence.channels
        if CHANNELS[channel] == stage and channel in PLACES
    ]


def _equally_good(evidence: Evidence, found: Sequence[Assessment], simpler: Assessment) -> list[int]:
    """Return the indices of the hypotheses that explain as much as the best one in each channel, best first.

    A fraction of a large error in one channel may be all of another.

    Args:
        evidence: the recording compared with the given model.
        found: the hypotheses.
        simpler: the one that they extend.
    """
    scale = inflations(evidence, found)
    scores = [j.score(scale) for j in found]
    order = sorted(range(len(found)), key=lambda i: -scores[i])
    most, least = found[order[0]].gains(scale), simpler.gains(scale)
    allowed = {c: max(rules.EQUAL, rules.EQUAL_FRACTION * (gain - least.get(c, 0.0))) for c, gain in most.items()}

    def is_equal(j: Assessment) -> bool:
        gains = j.gains(scale)
        return all(gains.get(c, 0.0) >= most[c] - allowed[c] for c in most)

    enough = scores[order[0]] - sum(allowed.values())
    return [i for i in order if scores[i] >= enough and is_equal(found[i])]


def _simplest(evidence: Evidence, offers: Sequence[_Offer], nothing: Assessment) -> _Offer:
    """Return the offer with the fewest causes and parameters of those that explain as much."""
    equal = [offers[i] for i in _equally_good(evidence, [offer.more for offer in offers], nothing)]
    return min(equal, key=lambda offer: (len(offer.more.names), len(offer.more.fit.values)))


def _is_worthwhile(evidence: Evidence, found: Searched, offer: _Offer, stage: Stage) -> bool:
    """Return whether a term closes enough of the remainder.

    The forms of a model that is none of the rig err in every stage, and each resembles some term: where form errors count as
    noise, or more remains in other stages, a term must close nearly all, and there exceed errors of form.
    """
    share = share_closed(evidence, offer.more, offer.base)
    if evidence.standard.form_is_noise:
        return share >= rules.CLOSED
    full, with_term = with_allowances(evidence, found._replace(best=offer.more, places=()))
    if not any(item.unexplained for item in remainders(full, with_term) if CHANNELS[item.channel] != stage):
        return share >= rules.WORTHWHILE
    return share >= rules.CLOSED and relevance(evidence, differences(evidence, offer.more, offer.base)) >= rules.FORM_ERROR


def _as_formula(pool: Pool, offer: _Offer, nothing: Assessment) -> _Offer:
    """Return a term as the formula of fewest parameters that explains as much as its table; the table if none does.

    With the right formula, named causes that only made up for the table are not needed.

    Args:
        pool: the threads.
        offer: the term as a table.
        nothing: the hypothesis without causes.
    """
    evidence, (base, more, proposal) = pool.evidence, offer
    candidate, part = more.hypothesis[-1], parts(more.hypothesis)[-1]
    if dict(candidate.fixed).get("knots") == 0.0:
        return offer
    values, table = more.fit.values[part], slice(len(candidate.free) - proposal.knots, None)
    scale = _scale_of(proposal)
    covariance = more.held_out.covariance[part, part][table, table]
    at = (_places(proposal, candidate, values) - scale.zero) / scale.size
    known = Table(at, values[table], covariance, proposal.periodic, _signed(proposal))
    memory = {name: value for name, value in zip(candidate.free, values.tolist(), strict=True) if name in MEMORIES}
    fits = pool.map(_linearised, [formula_of(proposal, formula, memory) for formula in formulas(known)])
    begun = [
        combined(evidence, beside.fit, fit)
        for fit in fits
        if fit is not None
        for beside in ((base, nothing) if base.names else (base,))
    ]
    found = [more, *(fitted(evidence, pool, begun, len(begun)) if begun else [])]
    best = min((found[i] for i in _equally_good(evidence, found, base)), key=lambda j: len(j.fit.values))
    return _Offer(base if len(best.names) > 1 else nothing, best, proposal)


def _sketched(proposal: Proposal) -> list[Candidate]:
    """Return the formulas that describe the values estimated for a table, for a term that a coarse table may not lead to."""
    if not proposal.sketch:
        return []
    scale, values = _scale_of(proposal), np.array(proposal.sketch)
    at = (np.linspace(proposal.low, proposal.high, len(values)) - scale.zero) / scale.size
    errors = np.diag(np.square(proposal.sketch_std))
    return [formula_of(proposal, f) for f in formulas(Table(at, values, errors, False, _signed(proposal)))]


class _Scale(NamedTuple):
    """Zero and unit of a formula's argument, in the argument's SI unit."""

    zero: float
    size: float


def _signed(proposal: Proposal) -> bool:
    """Return whether an argument has a natural zero."""
    return proposal.argument not in ("time", "temperature")


def _scale_of(proposal: Proposal) -> _Scale:
    """Return the scale in which an argument reaches 1, for a term that repeats after one period."""
    if proposal.play > 0.0:
        return _Scale(0.0, proposal.play)
    low, high = proposal.reach
    if proposal.periodic:
        return _Scale(0.0 if _signed(proposal) else low, proposal.high - proposal.low)
    return _Scale(0.0, max(abs(low), abs(high))) if _signed(proposal) else _Scale(low, high - low)


def _places(proposal: Proposal, candidate: Candidate, values: Array) -> Array:
    """Return the places of a fitted table's knots, in the argument's SI unit, shape (knots,)."""
    used = candidate.use(values).parameters._asdict()
    steps = proposal.knots if proposal.periodic else proposal.knots - 1
    return (np.arange(proposal.knots) / steps - used["offset"]) / used[_weight(proposal)]


def _weight(proposal: Proposal) -> str:
    """Return the weight that gives an argument's scale; the spool displacement is the command less the error."""
    return "per_spool" if proposal.argument == DISPLACEMENT else f"per_{proposal.argument}"


def candidate_of(proposal: Proposal) -> Candidate:
    """Return the hypothesis of a proposed table."""
    scale = _Scale(proposal.low, proposal.high - proposal.low)
    table = dict(zip(VALUES, proposal.start or (0.0,) * proposal.knots, strict=False))
    fixed = {**_argument(proposal, scale), "knots": float(proposal.knots)}
    memory = {"direction": proposal.direction, "memory": proposal.lag, "play": proposal.play / scale.size}
    free = {**{name: value for name, value in memory.items() if value > 0.0}, **table}
    bounds = _memory_bounds(free)
    if proposal.periodic:
        size = fixed.pop(_weight(proposal))
        del fixed["offset"]
        free = {_weight(proposal): size, **free}
        # Another period would be another hypothesis.
        bounds[_weight(proposal)] = (1.0 - PERIOD_RANGE) * size, (1.0 + PERIOD_RANGE) * size
    return _candidate(proposal, free, fixed, bounds, dict.fromkeys(VALUES, 0.0))


def formula_of(proposal: Proposal, formula: Formula, memory: Mapping[str, float] = MappingProxyType({})) -> Candidate:
    """Return the hypothesis of a formula in place of a table.

    Args:
        proposal: the table.
        formula: parameters of the formula.
        memory: fitted parameters of the table's memory and direction.
    """
    scale = _scale_of(proposal)
    fixed = {**_argument(proposal, scale, FORMULA_REACH), **formula.fixed, "knots": 0.0}
    bounds = {**_memory_bounds(memory), **formula.bounds}
    if "wave_number" in formula.free:
        number = formula.free["wave_number"]
        bounds["wave_number"] = (1.0 - PERIOD_RANGE) * number, (1.0 + PERIOD_RANGE) * number
    return _candidate(proposal, {**memory, **formula.free}, fixed, bounds, dict.fromkeys(SIZES, 0.0))


def _argument(proposal: Proposal, scale: _Scale, half_ranges: float = 1.0) -> dict[str, float]:
    """Return the parameters of a term's argument and factor, without those of a memory.

    Args:
        proposal: the table.
        scale: of the argument.
        half_ranges: distance from the middle of the data up to which the term changes, in half ranges of theirs.
    """
    size = 1.0 / scale.size
    weights = {_weight(proposal): size} | ({"per_error": -size} if proposal.argument == DISPLACEMENT else {})
    factor = {f"times_{proposal.factor}": 1.0 / proposal.factor_reach} if proposal.factor else {}
    if proposal.periodic:
        return {**weights, **factor, "offset": -scale.zero * size, "periodic": 1.0}
    low, high = proposal.reach
    further = 0.5 * (high - low) * (half_ranges - 1.0) if _signed(proposal) else 0.0
    play = MEMORY_RANGE * proposal.play
    ends = (-play, play) if play > 0.0 else (low - further, high + further)
    lowest, highest = ((end - scale.zero) * size for end in ends)
    reach = {"lowest": float(np.clip(lowest, -10.0, 0.0)), "highest": float(np.clip(highest, 1.0, 11.0))}
    return {**weights, **factor, **reach, "offset": -scale.zero * size}


def _memory_bounds(free: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the ranges of a term's direction and memory."""
    return {name: (free[name] / MEMORY_RANGE, free[name] * MEMORY_RANGE) for name in MEMORIES if name in free}


def _candidate(
    proposal: Proposal,
    free: Mapping[str, float],
    fixed: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    neutral: Mapping[str, float],
) -> Candidate:
    """Return a term as a hypothesis.

    Args:
        proposal: the table that it began as.
        free: starting values of the fitted parameters.
        fixed: the other parameters that are not neutral.
        bounds: ranges of the fitted parameters that are narrower than declared.
        neutral: values of the parameters without which the term is none.
    """
    declared = {d.name: d for d in declarations(EFFECTS.load(proposal.effect).Parameters)}
    ranges = [bounds.get(name, (declared[name].minimum, declared[name].maximum)) for name in free]
    lower, upper = np.array(ranges, dtype=np.float64).T
    start = np.clip(np.array(list(free.values())), lower, upper)
    place = list(SIGNAL_OF).index(proposal.argument) + len(SIGNAL_OF) * proposal.periodic
    return Candidate(
        proposal.effect,
        place,
        tuple(free),
        tuple(fixed.items()),
        start[np.newaxis],
        lower,
        upper,
        tuple(declared[name].unit for name in free),
        np.array([neutral.get(name, value) for name, value in zip(free, start.tolist(), strict=True)]),
    )


def _windows(worker: Worker, channel: Channel, proposal: Proposal) -> Array:
    """Return a channel's windows for each value of a table, from runs of the model, shape (windows, knots)."""
    block, floor = worker.evidence.block, worker.evidence.floor[channel]
    fit = _linearised(worker, candidate_of(proposal))
    if fit is None or channel not in fit.channels:
        return np.zeros((len(floor), proposal.knots))
    return floor[:, np.newaxis] * fit.jacobian[sections(block, fit.channels)[channel], -proposal.knots :]


def _linearised(worker: Worker, candidate: Candidate) -> Fit | None:
    fit = worker.linearise((candidate,), candidate.starts[0])
    return fit if fit.channels and np.any(fit.jacobian) else None


def _term(evidence: Evidence, offer: _Offer) -> Term:
    """Return the result of a fitted term, the last cause of a hypothesis."""
    proposal, more = offer.proposal, offer.more
    candidate, part = more.hypothesis[-1], parts(more.hypothesis)[-1]
    values, covariance = more.fit.values[part], more.held_out.covariance[part, part]
    used = candidate.use(values).parameters._asdict()
    unit = next(d.unit for d in declarations(EFFECTS.load(candidate.name).Parameters) if d.name == "level")
    argument = _signal(proposal.effect, proposal.argument)
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std = dict(zip(candidate.free, deviations.tolist(), strict=True))
    per, length = used[_weight(proposal)], argument_unit(argument)
    if used["knots"] > 0.0:
        table = slice(len(candidate.free) - proposal.knots, None)
        at, shown, errors = _places(proposal, candidate, values), values[table], deviations[table]
        reading, shapes = read(at, shown, covariance[table, table], periodic=proposal.periodic), tuple[Shape, ...]()
        period = Estimate(1.0 / per, std[_weight(proposal)] / per**2, length) if proposal.periodic else None
    else:
        shapes = shapes_of(used, std, _Scale(-used["offset"] / per, 1.0 / per), (length, unit))
        period = next((shape.numbers["period"] for shape in shapes if shape.name == "wave"), None)
        at = _pictured(proposal, period)
        shown, errors = _drawn(candidate, values, covariance, at * per + used["offset"])
        reading = read_formula(shapes, shown, errors)
    return Term(
        effect=candidate.name,
        argument=argument,
        magnitude=proposal.argument == "speed",
        error=proposal.argument == ERROR,
        factor_error=proposal.factor == ERROR,
        unit=unit,
        at=at,
        values=shown,
        std=errors,
        period=period,
        closed=min(share_closed(evidence, more, offer.base), 1.0),
        direction=used["direction"],
        reading=reading,
        formula=shapes,
        factor=_signal(proposal.effect, proposal.factor) if proposal.factor else "",
        factor_reach=proposal.factor_reach,
        lag=Estimate(used["memory"], std["memory"], "s") if proposal.lag > 0.0 else None,
        play=Estimate(used["play"] / per, std["play"] / per, length) if proposal.play > 0.0 else None,
    )


def _pictured(proposal: Proposal, period: Estimate | None) -> Array:
    """Return the arguments at which a formula is drawn: the range of the data, or a period."""
    low, high = (-0.5 * proposal.play, 0.5 * proposal.play) if proposal.play > 0.0 else proposal.reach
    return np.linspace(low, high if period is None else low + period.value, SHOWN_POINTS)


def _drawn(candidate: Candidate, values: Array, covariance: Array, u: Array) -> tuple[Array, Array]:
    """Return the values of a formula and their standard errors, shape (n,) each.

    Args:
        candidate: the term.
        values: of its free parameters, shape (p,).
        covariance: of these, shape (p, p).
        u: arguments, shape (n,).
    """
    drawn, slopes = value_of(candidate.use(values).parameters, u), np.zeros((len(u), len(values)))
    for i, value in enumerate(values.tolist()):
        step = SLOPE_STEP * max(abs(value), math.sqrt(max(covariance[i, i], 0.0)), 1e-12)
        moved = values.copy()
        moved[i] += step if value + step <= candidate.upper[i] else -step
        slopes[:, i] = (value_of(candidate.use(moved).parameters, u) - drawn) / (moved[i] - value)
    return drawn, np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", slopes, covariance, slopes), 0.0))


def _signal(effect: str, argument: str) -> str:
    """Return the signal that an argument is formed of; the spool's input is the command."""
    return COMMAND if (effect, argument) == ("empirical_spool", "spool") else SIGNAL_OF[argument]


def drifts(evidence: Evidence, best: Fit, without: Fit) -> tuple[str, ...]:
    """Return the terms over time that reproduce what a cause changes, because the signal that it needs followed the time.

    Args:
        evidence: the recording compared with the given model.
        best: the hypothesis with the cause, fitted.
        without: the same without it.
    """
    change = {c: best.residuals.values[c] - without.residuals.values[c] for c in evidence.channels}
    main = max(change, key=lambda c: float(np.sum(change[c] ** 2)))
    worker, time, out = Worker(evidence), evidence.record.time, list[str]()
    ends = float(time[0]), float(time[-1])
    for effect, place in PLACES.get(main, {}).items():
        factors = [factor for argument, factor in place.products if argument == "time"]
        for factor in ("", *factors) if "time" in place.single else factors:
            candidate = candidate_of(Proposal(0.0, effect, "time", *ends, ends, TIME_KNOTS, factor=factor))
            fit = worker.linearise((candidate,), candidate.starts[0])
            within_reach = np.concatenate([change[c] for c in fit.channels])
            reached = fit.jacobian @ np.linalg.lstsq(fit.jacobian, within_reach, rcond=None)[0]
            if float(reached @ reached) >= rules.CLOSED * float(sum(np.sum(e * e) for e in change.values())):
                out.append(effect)
    return tuple(dict.fromkeys(out))


def leaves_less(evidence: Evidence, term: Described, answer: PartialAnswer) -> bool:
    """Return whether a term leaves so much less of the error than a partial answer's causes that it is offered instead."""
    channel = most_explained(term.without.held_out.residuals, term.best.held_out.residuals)
    noise = power(evidence.noise[channel])
    with_term = power(term.best.held_out.residuals.values[channel])
    e = answer.found.best.held_out.residuals.values[channel] * answer.evidence.floor[channel] / evidence.floor[channel]
    return DEARER * (with_term - noise) <= power(e) - noise
