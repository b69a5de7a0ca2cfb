"""Candidate causes of a model's error: every effect, in every form in which it can be fitted."""

import math
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.record import Record
from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS, Form, Peak, Period, Quantile, Share, Start
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.schema import Declaration, declarations


class Candidate(NamedTuple):
    """One effect in one of its forms.

    Attributes:
        name: the effect's name.
        number: number of the form in the effect's file.
        free: names of the parameters to fit.
        fixed: names and values of the other non-neutral parameters.
        starts: starting values of the free parameters, shape (starts, free).
        lower, upper: range of the free parameters, shape (free,).
        units: units of the free parameters.
        neutral: their neutral values, shape (free,).
    """

    name: str
    number: int
    free: tuple[str, ...]
    fixed: tuple[tuple[str, float], ...]
    starts: Array
    lower: Array
    upper: Array
    units: tuple[str, ...]
    neutral: Array

    @property
    def separates_load(self) -> bool:
        """Whether the effect separates the load from the piston; a rig can have only one such effect."""
        return self.use(self.starts[-1]).piston_share > 0.0

    @property
    def parts_mass(self) -> bool:
        """Whether the effect lets a mass move relative to the piston: the load, or a fitted mass."""
        return self.separates_load or "kg" in self.units

    @property
    def yielding(self) -> tuple[int, ...]:
        """Indices of the free parameters that tell how far a mass yields; empty if the effect lets none yield."""
        names = getattr(EFFECTS.load(self.name), "YIELDING", ())
        return tuple(index for index, name in enumerate(self.free) if name in names)

    def use(self, values: Array) -> EffectUse:
        """Return the effect with values of the free parameters, clipped to their ranges."""
        inside = np.clip(values, self.lower, self.upper)
        named = {**dict(self.fixed), **{n: float(v) for n, v in zip(self.free, inside, strict=True)}}
        return EffectUse(self.name, EFFECTS.load(self.name).Parameters(**named))


Hypothesis = tuple[Candidate, ...]
"""Candidates that act together; an empty tuple is the given model."""


def parts(hypothesis: Hypothesis) -> list[slice]:
    """Return the slice of each candidate in the joint vector of free parameters."""
    ends = np.cumsum([0, *[len(c.free) for c in hypothesis]])
    return [slice(int(begin), int(end)) for begin, end in pairwise(ends)]


def extended(rig: Rig, hypothesis: Hypothesis, values: Array) -> Rig:
    """Return a rig with the effects of a hypothesis.

    Args:
        rig: the given model.
        hypothesis: the candidates to add.
        values: the joint vector of their free parameters.
    """
    for cause, part in zip(hypothesis, parts(hypothesis), strict=True):
        rig = grown(rig, cause.use(values[part]))
    return rig


def grown(rig: Rig, more: EffectUse) -> Rig:
    """Return a rig with one more effect; one that the rig has already grows by the additional one.

    Coefficients can be shifted repeatedly. Of two uses of another effect, only the last would act in the equations: parameters
    that are neutral at 0 are summed, and factors multiplied.
    """
    present = next((i for i, use in enumerate(rig.effects) if use.name == more.name), None)
    if present is None or only_shifts(more.name):
        return rig.with_effects((more,))
    old = rig.effects[present].parameters
    total = {
        name: now * by / neutral if neutral else now + by
        for (name, now), by, neutral in zip(old._asdict().items(), more.parameters, type(old)(), strict=True)
    }
    return rig._replace(
        effects=(*rig.effects[:present], more._replace(parameters=old._replace(**total)), *rig.effects[present + 1 :])
    )


def only_shifts(name: str) -> bool:
    """Return whether an effect does nothing but shift coefficients of the rig."""
    effect = EFFECTS.load(name)
    return hasattr(effect, "shift") and not any(hasattr(effect, hook) for hook in HOOKS)


def bounds(hypothesis: Hypothesis) -> tuple[Array, Array]:
    """Return lower and upper bounds of the joint vector of free parameters."""
    if not hypothesis:
        return np.empty(0), np.empty(0)
    return np.concatenate([c.lower for c in hypothesis]), np.concatenate([c.upper for c in hypothesis])


Periods = Callable[[Period], float | None]
"""Returns a period found in the residual, None if there is none."""


def no_period(of: Period) -> float | None:
    """Return None, where periods are not looked for."""
    return None


def candidates(
    record: Record, rig: Rig, lines: Sequence[float], periods: Periods = no_period
) -> tuple[list[Candidate], dict[str, str]]:
    """Return every effect in every form testable with a recording.

    Args:
        record: the recording.
        rig: the given model; an effect that it has already is tried as a growth of it, if it can grow.
        lines: frequencies of the strongest lines in the residuals' spectra [Hz].
        periods: looks for the periods from which forms start.

    Returns:
        The candidates, and the reason for each effect that cannot be tried.
    """
    found, out = list[Candidate](), dict[str, str]()
    for name in EFFECTS.names():
        effect = EFFECTS.load(name)
        missing = [signal for signal in getattr(effect, "NEEDS", ()) if signal not in record]
        if missing:
            out[name] = f"needs {', '.join(missing)}"
            continue
        tried = [_candidate(name, number, form, record, lines, periods) for number, form in enumerate(effect.forms(rig))]
        present = next((use.parameters for use in rig.effects if use.name == name), None)
        if present is not None and not only_shifts(name):
            if any(candidate.separates_load or np.any(candidate.neutral) or candidate.fixed for candidate in tried):
                out[name] = "the rig file has it already"
                continue
            tried = [_growth(candidate, present) for candidate in tried]
        if not all(np.all(np.isfinite(candidate.starts)) for candidate in tried):
            out[name] = "needs values missing from the rig file"
            continue
        found += tried
    return found, out


def _growth(candidate: Candidate, present: Any) -> Candidate:
    """Return a candidate whose parameters, added to those of the same effect in the rig, stay within their ranges."""
    already = np.array([getattr(present, name) for name in candidate.free])
    return candidate._replace(lower=candidate.lower - already, upper=candidate.upper - already)


def at_lines(found: Sequence[Candidate], record: Record, rig: Rig, lines: Sequence[float]) -> list[Candidate]:
    """Return the candidates with starts at spectral lines, restarted at other lines.

    Args:
        found: result of :func:`candidates`.
        record: the recording.
        rig: the given model.
        lines: frequencies of the strongest lines in the spectrum of the remaining residual [Hz].
    """
    out = []
    for candidate in found:
        form = EFFECTS.load(candidate.name).forms(rig)[candidate.number]
        rows = {i for starts in form.free.values() for i, start in enumerate(starts) if isinstance(start, Peak)}
        if rows and lines:
            free = {p: tuple(s for i, s in enumerate(starts) if i in rows) for p, starts in form.free.items()}
            out.append(_candidate(candidate.name, candidate.number, form._replace(free=free), record, lines))
    return out


@cache
def _declared(name: str) -> dict[str, Declaration]:
    return {d.name: d for d in declarations(EFFECTS.load(name).Parameters)}


def _candidate(
    name: str, number: int, form: Form, record: Record, lines: Sequence[float], periods: Periods = no_period
) -> Candidate:
    declared = _declared(name)
    free = tuple(form.free)
    count = max([1, *[len(starts) for starts in form.free.values()]])
    rows = np.empty((count, len(free)))
    neutral = np.array([float(declared[p].default) for p in free])
    for column, parameter in enumerate(free):
        starts = form.free[parameter] or (float(declared[parameter].default),) * count
        if len(starts) != count:
            raise BadInput(
                f"{parameter} has {len(starts)} starts", f"effect {name}, form {number}", f"{count}, as many as the others"
            )
        rows[:, column] = [_start(start, record, lines, periods) for start in starts]
    absent = [i for starts in form.free.values() for i, s in enumerate(starts) if isinstance(s, Period) and periods(s) is None]
    rows = np.delete(rows, absent, axis=0)
    lower = np.array([_finite(declared[p].minimum, -np.inf) for p in free])
    upper = np.array([_finite(declared[p].maximum, np.inf) for p in free])
    for column, parameter in enumerate(free):
        quantiles = [start for start in form.free[parameter] if isinstance(start, Quantile)]
        if quantiles:
            # A threshold at one end of a signal's range must not settle in its middle.
            values = record.values(quantiles[0].signal)
            if min(q.fraction for q in quantiles) > 0.5:
                lower[column] = max(lower[column], float(np.median(values)))
            elif max(q.fraction for q in quantiles) < 0.5:
                upper[column] = min(upper[column], float(np.median(values)))
        elif form.free[parameter] and all(isinstance(start, Peak) for start in form.free[parameter]):
            # A faster line shows only in the initial state of the friction.
            window = max(rules.WINDOW, rules.MIN_WINDOW * record.period)
            upper[column] = min(upper[column], rules.LINE_PERIODS / window)
            lower[column] = max(lower[column], rules.LINE_PERIODS / record.duration)
    if all(form.free.values()):
        # A small effect is found from the neutral values, provided the loss has a gradient there.
        rows = np.vstack([neutral, rows])
    rows = np.clip(rows, lower, upper)
    units = tuple(declared[p].unit for p in free)
    return Candidate(name, number, free, tuple(form.fixed.items()), np.unique(rows, axis=0), lower, upper, units, neutral)


def _finite(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else float(value)


def _start(start: Start, record: Record, lines: Sequence[float], periods: Periods) -> float:
    if isinstance(start, Share):
        return start.fraction * float(np.max(np.abs(record.values(start.signal))))
    if isinstance(start, Quantile):
        return float(np.quantile(record.values(start.signal), start.fraction))
    if isinstance(start, Peak):
        return float(lines[min(start.rank, len(lines)) - 1]) if lines else 1.0
    if isinstance(start, Period):
        found = periods(start)
        return math.nan if found is None else found
    return float(start)
