"""Excitation of each stage: whether the data suffice to show an error in it."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import shows
from ehls_ros.diagnosis.evidence import Evidence, sections
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.hypotheses import Candidate, extended
from ehls_ros.diagnosis.loss import rms
from ehls_ros.diagnosis.result import Sensitivity
from ehls_ros.diagnosis.stages import Channel, Comparison, Stage

NINE_OF_TEN = 1.2816
"""Standard deviations below which a normal variable lies in nine of ten cases.

Origin: a quantile.
"""

GROWTH, MAX_GROWTHS = 1.2, 100
"""Factor by which a size is enlarged until it shows beyond the allowances, and how often at most.

Origin: numerical; sizes are told to a fifth.
"""

ROUNDING, ROUNDED = 1e-9, 1e-6
"""Fraction by which a size that shows may fall short by rounding, and whitened change of an effect that does nothing.

Origin: numerical.
"""

RUNS = 4
"""Most sizes at which an effect that is not smooth at its neutral value is run, until the last two agree.

Origin: numerical; those whose residuals grow like a power of their size need two or three.
"""

HALVINGS = 4
"""Halvings, by ratio, of the sizes between which one with a threshold begins to show.

Origin: numerical; a range of a decade is told to 15 %.
"""

POWERS = (0.25, 4.0)
"""Least and largest power of its size with which an effect grows that has no threshold.

Origin: judgement; play and overlap grow with powers of 0.5 to 2.
"""

KEYS: Mapping[Stage, tuple[str, str]] = {
    "valve": ("valve_gain_shift", "gain"),
    "flow": ("valve_gain_shift", "flow_gain"),
    "force_balance": ("coulomb_shift", "offset"),
}
"""Stages that need excitation, with the effect and its parameter by which it is judged; the sensors' stage needs none."""


class Direction(NamedTuple):
    """A direction in which an effect grows from the given model.

    Attributes:
        cause: the effect.
        parameters: indices of the parameters that tell its size, in its free ones.
        origin: values of the free parameters at which it does nothing, shape (free,).
        step: their change for a size of 1, shape (free,).
        columns: change of the whitened residuals for a size of 1, by channel, as far as it is linear.
        known: size at which they were found; 0 for derivatives that hold for other sizes as well.
    """

    cause: Candidate
    parameters: tuple[int, ...]
    origin: Array
    step: Array
    columns: Mapping[Channel, Array]
    known: float = 0.0

    @property
    def largest(self) -> float:
        """The size at which a parameter reaches the end of its range."""
        room = np.where(self.step > 0.0, self.cause.upper - self.origin, self.origin - self.cause.lower)
        moved = self.step != 0.0
        return float(np.min(room[moved] / np.abs(self.step[moved])))

    def sizes(self, size: float) -> tuple[Sensitivity, ...]:
        """Return the size, parameter by parameter."""
        cause = self.cause
        return tuple(
            Sensitivity(cause.name, cause.free[i], size * abs(float(self.step[i])), cause.units[i]) for i in self.parameters
        )


def sensitivities(
    evidence: Evidence, screened: Sequence[Fit], inflation: Mapping[Channel, float], *, beside_form: bool = True
) -> tuple[Sensitivity, ...]:
    """Return the smallest detectable size of every effect that grows steadily from its neutral value.

    The size may be outside the parameter's range: no such effect would have shown.

    Args:
        evidence: the recording compared with the given model.
        screened: every cause alone at its starting values, with its derivatives.
        inflation: divisor of each channel's losses.
        beside_form: whether an effect must exceed the errors of form that cannot be told from a change.
    """
    out, comparison = list[Sensitivity](), evidence.comparison()
    # A form with several parameters is needed where none has just one.
    for fit in sorted(screened, key=lambda fit: len(fit.values) > 1):
        if len(fit.values) > 1 and any(told.name == fit.hypothesis[0].name for told in out):
            continue
        for direction in directions(evidence, fit):
            columns = direction.columns
            informed = {c: float(column @ column) / inflation.get(c, 1.0) for c, column in columns.items()}
            # By the channel in which it shows most.
            main = max(columns, key=informed.__getitem__)
            # At the size of one standard deviation of the noise, within the bounds of the allowances.
            length = max(float(np.linalg.norm(columns[main])), 1e-300)
            whole = length * evidence.whole(main, columns[main] / length)
            effect = evidence.nrmse(main, whole)
            smallest = smallest_detectable(sum(informed.values()), effect, rules.RELEVANT, evidence.standard.needed_gain)
            if smallest is not None:
                smallest = max(smallest, rules.SHOWN / max(rms(whole), 1e-300))
                form = {c: evidence.standard.form_error(c) if beside_form else 0.0 for c in columns}
                smallest = beyond_allowances(evidence, comparison, direction, smallest, form, inflation)
            if smallest is not None:
                out += direction.sizes(smallest)
    return tuple(out)


def directions(evidence: Evidence, fit: Fit) -> list[Direction]:
    """Return the directions in which an effect grows: by each parameter at its neutral value, or from there to its start.

    Args:
        evidence: the recording compared with the given model.
        fit: the cause alone at its starting values, with its derivatives.
    """
    (cause,), rows = fit.hypothesis, sections(evidence.block, fit.channels)
    # A rig with one more effect has kernels of its own, which round differently.
    if all(np.allclose(fit.residuals.values[c], evidence.base.values[c], rtol=0.0, atol=ROUNDED) for c in fit.channels):
        found = [i for i, start in enumerate(fit.values) if start == cause.neutral[i] and np.any(fit.jacobian[:, i])]
        # Another parameter may be what switches the effect on.
        known = fit.steps if len(fit.values) > 1 else np.zeros(1)
        steps, columns = np.eye(len(fit.values)), [{c: fit.jacobian[own, i] for c, own in rows.items()} for i in found]
        return [Direction(cause, (i,), fit.values, steps[i], of, abs(known[i])) for i, of in zip(found, columns, strict=True)]
    apart = fit.values - cause.neutral
    size = float(np.max(np.abs(apart)))
    if size == 0.0 or (len(apart) > 1 and (len(set(cause.units)) > 1 or np.any(cause.neutral))):
        return []
    change = {c: (fit.residuals.values[c] - evidence.base.values[c]) / size for c in fit.channels}
    return [Direction(cause, tuple(range(len(apart))), cause.neutral, apart / size, change, size)]


def beyond_allowances(
    evidence: Evidence,
    comparison: Comparison,
    direction: Direction,
    smallest: float,
    form: Mapping[Channel, float],
    inflation: Mapping[Channel, float],
) -> float | None:
    """Return the size that shows beyond the variation that is allowed within bounds.

    The residuals are not linear in it: within the bounds a change hardly counts, beyond them it does.

    Args:
        evidence: the recording compared with the given model.
        comparison: comparison of the calling thread.
        direction: that of the effect.
        smallest: size that would show if residuals were linear.
        form: error of form that it must exceed in some channel, as a fraction of the largest term.
        inflation: divisor of each channel's losses.

    Returns:
        The size; beyond the range of the effect's parameter if none of it shows. None for an effect that shrinks, or
        begins abruptly or only at the end of that range, such as a limit.
    """

    def shown_from(tried: float) -> float:
        """Return the size that would show if the change at this size were in proportion to it."""
        changed = extended(evidence.rig, (direction.cause,), direction.origin + tried * direction.step)
        moved, base = evidence.residuals(comparison, changed).values, evidence.base.values
        per_size = {c: (evidence.whole(c, moved[c]) - evidence.whole(c, base[c])) / tried for c in direction.columns}
        return _shown_from(evidence, per_size, smallest, form, inflation)

    tried = min(smallest, direction.largest)
    if tried <= 0.0:
        return smallest
    if direction.known == 0.0:
        return shown_from(tried) if any(c in evidence.allowed for c in direction.columns) else smallest
    before = direction.known, smallest
    for _ in range(RUNS):
        shown = shown_from(tried)
        if shown < GROWTH * tried < GROWTH**2 * shown:
            return shown
        power = _power(before, (tried, shown))
        if tried == direction.largest:
            return shown if power > 0.0 else None
        before = tried, shown
        if not POWERS[0] < power < POWERS[1]:
            break
        tried = min(tried * (shown / tried) ** (1.0 / power), direction.largest)
    return _beyond_threshold(shown_from, *before, direction.largest)


def _beyond_threshold(shown_from: Callable[[float], float], tried: float, shown: float, largest: float) -> float | None:
    """Return the size that shows of an effect that does not grow like a power of it; see :func:`beyond_allowances`.

    Args:
        shown_from: returns the size that would show if the change at a given size were in proportion to it.
        tried: a size.
        shown: the size that would show if the change at that one were in proportion to it.
        largest: the end of the range.
    """
    at_end = shown_from(largest)
    if shown <= tried or largest / at_end <= tried / shown:
        return None
    if at_end > largest:
        return at_end
    hidden, seen = tried, largest
    for _ in range(HALVINGS):
        middle = math.sqrt(hidden * seen)
        hidden, seen = (hidden, middle) if shown_from(middle) <= middle else (middle, seen)
    return seen if seen < largest else None


def _power(before: tuple[float, float], now: tuple[float, float]) -> float:
    """Return the power of its size with which a change grows, from two sizes; 1 if they are equal.

    Args:
        before: a size, and the one that would show if the change were in proportion to it.
        now: another such pair.
    """
    (one, shows_one), (other, shows_other) = before, now
    grown = math.log(other / one)
    return (math.log(shows_one / one) - math.log(shows_other / other)) / grown if grown != 0.0 else 1.0


def _shown_from(
    evidence: Evidence,
    per_size: Mapping[Channel, Array],
    smallest: float,
    form: Mapping[Channel, float],
    inflation: Mapping[Channel, float],
) -> float:
    """Return the size from which a change in proportion to it shows, with the allowances for its true size."""
    needed, standard = needed_sigmas(evidence.standard.needed_gain), evidence.standard

    def shows_at(size: float) -> bool:
        information, relevant, stands_out = 0.0, False, False
        for c, column in per_size.items():
            change, given = size * column, evidence.allowed.get(c)
            seen = change if given is None else given.whitened(change)
            information += float(seen @ seen) / inflation.get(c, 1.0)
            counted = standard.counted(evidence, c, change)
            exceeds = evidence.nrmse(c, standard.beyond(evidence, c, counted)) > form[c]
            relevant |= exceeds and evidence.nrmse(c, counted) >= (1.0 - ROUNDING) * rules.RELEVANT
            stands_out |= shows([counted], (1.0 - ROUNDING) * rules.SHOWN)
        return information >= (1.0 - ROUNDING) * needed**2 and relevant and stands_out

    # From the size that would show if nothing were allowed.
    certain = sum(float(column @ column) / inflation.get(c, 1.0) for c, column in per_size.items())
    standing_out = rules.SHOWN / max(*(rms(column) for column in per_size.values()), 1e-300)
    size = smallest if certain == 0.0 else max(needed / math.sqrt(certain), standing_out)
    for _ in range(MAX_GROWTHS):
        if shows_at(size):
            break
        size *= GROWTH
    return size


def needed_sigmas(gain: float) -> float:
    """Return the standard errors from which a parameter is significant and gains enough, in nine of ten recordings.

    At the threshold itself, the scatter would hide every other one.
    """
    return max(rules.MIN_SIGMAS, math.sqrt(2.0 * gain)) + NINE_OF_TEN


def smallest_detectable(
    information: float, effect: float, least: float = rules.RELEVANT, gain: float = rules.NEEDED_GAIN
) -> float | None:
    """Return the smallest parameter that is significant, gains enough and is relevant, in nine of ten recordings.

    Args:
        information: sum of squared derivatives of the whitened residuals.
        effect: derivative of the balance's rms, as a fraction of its largest term.
        least: relevant rms, as the same fraction.
        gain: needed gain [nat].

    Returns:
        The parameter; None without information.
    """
    if information <= 0.0:
        return None
    smallest = needed_sigmas(gain) / math.sqrt(information)
    return max(smallest, least / effect) if effect > 0.0 else smallest


def mass_observable(evidence: Evidence) -> bool:
    """Return whether the moving mass is observable: whether doubling it changes a balance noticeably.

    A piston that hardly accelerates moves the same with any mass. A separate mass would then have to be far larger, or be a
    load of unknown mass, indistinguishable from friction.
    """
    plant = evidence.rig.plant
    heavier = evidence.rig._replace(plant=plant._replace(moving_mass=2.0 * plant.moving_mass))
    changed = evidence.residuals(evidence.comparison(), heavier).values
    return shows(evidence.whole(c, changed[c]) - evidence.whole(c, evidence.base.values[c]) for c in evidence.channels)


class Sliding(NamedTuple):
    """Quantities that decide whether the piston slides.

    Attributes:
        travel: range of the piston's motion [m].
        presliding: travel over which static friction builds up [m].
        coulomb: friction of steady sliding in the given model [N].
    """

    travel: float
    presliding: float
    coulomb: float


def sliding(evidence: Evidence) -> Sliding:
    """Compare the recorded travel with the given model's friction."""
    rig = evidence.rig.effective()
    presliding = rig.friction_level(0.0) / rig.friction_law.stiffness(rig.friction)
    return Sliding(evidence.travel, presliding, rig.friction_level(math.inf))


def excited(stage: Stage, found: Sequence[Sensitivity], slid: Sliding, largest: float = rules.MAX_UNDETECTED) -> bool:
    """Return whether the data could show an error of a stage's key parameter; for friction, the piston must also slide.

    Args:
        stage: the stage.
        found: the smallest detectable sizes.
        slid: travel and friction of the piston.
        largest: largest change that may remain undetected, as a fraction of the parameter's nominal value.
    """
    if stage not in KEYS:
        return True
    if stage == "force_balance" and slid.travel < rules.SLIDING * slid.presliding:
        return False
    nominal = slid.coulomb if stage == "force_balance" else 1.0
    return any(s.smallest < largest * nominal for s in found if (s.name, s.parameter) == KEYS[stage])
