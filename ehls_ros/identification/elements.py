"""Identification of the friction model with Maxwell-slip elements: number of elements, hysteresis loop and joint fit.

Other models are fitted by :mod:`ehls_ros.identification.declared`.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.identification import joint, presliding
from ehls_ros.identification.balance import Recorded, check_unit, linear_columns
from ehls_ros.identification.friction_run import MAX_PARTS, force_along, slopes_along
from ehls_ros.identification.joint import REACH, Coordinates, JointFit, Start
from ehls_ros.identification.motion import Motion, slides
from ehls_ros.identification.static import MIN_BLOCKS, StaticFit
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.rig import Rig

MODEL = "gms"
"""Name of the friction model with elements."""

EXPONENTS = (0.1, 4.0)
"""Range of the Stribeck exponent; a rig file allows no larger one."""

STATIC = ("coulomb_force", "static_rise", "stribeck_velocity", "stribeck_exponent")
"""Coordinates of the Stribeck curve."""

MAX_ELEMENTS = 4
"""Largest number of elements tried."""

EVIDENCE = 100.0
"""Decrease of the Bayesian information criterion required for one more element.

Far more than chance requires: motion at a reversal that the sensor does not resolve looks like one more element, too.
"""

RATES = np.geomspace(30.0, 3e4, 7)
"""Attraction rates C tried as starts [N/s]."""

STEADY_LAGS = 6.0
"""Lags s/C of the slipping elements after which sliding counts as steady."""

FORGET = 3e-3
"""Travel after which the elements no longer depend on a reversal, if presliding was not recorded [m]."""


UNDERSTATED = {"coulomb_force": 2.1, "attraction_rate": 5.7, "element_stiffness": 4.3}
"""Rms error in standard errors, in `benchmarks/identification.py`, of the coefficients for which it exceeds 2.

There, noise in the position loop moves the piston by less than the sensor resolves, in the same way in every stroke, so that
the scatter does not reveal it.
"""


class ElementCoordinates(NamedTuple):
    """Coordinates of a friction with elements, all logarithmic: weights relative to the last one, ``static_rise`` Fs - Fc.

    Attributes:
        elements: number of friction elements.
    """

    elements: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        numbers = range(1, self.elements + 1)
        return (
            *STATIC,
            "attraction_rate",
            *(f"element_stiffness_{i}" for i in numbers),
            *(f"element_weight_{i}" for i in numbers[:-1]),
        )

    def pack(self, friction: Friction) -> Array:
        """Return the coordinates of a friction, shape (len(names),)."""
        weight = np.asarray(friction.element_weight)
        scalars = (
            friction.coulomb_force,
            max(friction.static_force - friction.coulomb_force, 1e-3 * friction.coulomb_force),
            friction.stribeck_velocity,
            friction.stribeck_exponent,
            friction.attraction_rate,
        )
        return np.log([*scalars, *friction.element_stiffness, *(weight[:-1] / weight[-1])])

    def unpack(self, z: Array) -> Friction:
        """Return the friction at coordinates ``z``, without its viscous part."""
        coulomb, rise, velocity, exponent, rate, *stiffness = np.exp(z[: 5 + self.elements]).tolist()
        weight = [*np.exp(z[5 + self.elements :]).tolist(), 1.0]
        total = sum(weight)
        return Friction(
            coulomb_force=coulomb,
            static_force=coulomb + rise,
            stribeck_velocity=velocity,
            stribeck_exponent=exponent,
            viscous_coefficient=0.0,
            element_stiffness=tuple(stiffness),
            element_weight=tuple(one / total for one in weight),
            attraction_rate=rate,
        )

    def bounds(self, z: Array, period: float) -> tuple[Array, Array]:
        """Return the lowest and the highest coordinates of a search from ``z``; ``period`` is the blocks' length [s]."""
        low, high = z - REACH, z + REACH
        exponent, rate = self.names.index("stribeck_exponent"), self.names.index("attraction_rate")
        low[exponent] = max(low[exponent], math.log(EXPONENTS[0]))
        high[exponent] = min(high[exponent], math.log(EXPONENTS[1]))
        # Rates too fast for a block to resolve and for its integration to follow are indistinguishable.
        fastest = math.log(MAX_PARTS / period) + z[self.names.index("coulomb_force")]
        high[rate] = min(high[rate], fastest)
        low[rate] = min(low[rate], fastest - REACH)
        return low, high

    def force(self, motion: Motion, friction: Friction) -> Array:
        """Return the mean total force of the elements in each block, shape (n,) [N]."""
        return force_along(motion, MODEL, friction)

    def slopes(self, motion: Motion, friction: Any) -> Array:
        """Return the derivatives of the force by the tangents of a friction of duals, shape (n, tangents) [N]."""
        return slopes_along(motion, MODEL, friction)


class ElementsFit(NamedTuple):
    """Result of the fit of friction elements.

    Attributes:
        fit: the joint fit.
        branch: the mean branch of the hysteresis loop; None without reversals in presliding.
        nodes: nodes of the branch; empty without one.
        criteria: Bayesian information criterion by number of elements.
        remarks: sentences about the limits of the fit.
    """

    fit: JointFit
    branch: presliding.Branch | None
    nodes: tuple[presliding.Node, ...]
    criteria: Mapping[int, float]
    remarks: tuple[str, ...]


def understated(names: Iterable[str]) -> dict[str, float]:
    """Return the factors by which standard errors are known to be too small, for those of the coefficients concerned.

    Args:
        names: the fitted coefficients, those of an element with its number.
    """
    return {name: factor for name in names for known, factor in UNDERSTATED.items() if name.startswith(known)}


def fit_elements(
    recorded: Recorded, rig: Rig, start: Friction, steady: StaticFit | None, elements: int | None, report: Callable[[str], None]
) -> ElementsFit:
    """Determine the number of friction elements and fit the friction.

    Args:
        recorded: the recordings.
        rig: the rig as known so far, to detect a wrong unit.
        start: friction to start from, with the Stribeck curve of ``steady``.
        steady: the static fit; None without steady sliding.
        elements: number of elements; None: as many as the data show.
        report: called with the name of each step that begins.

    Returns:
        The fit.

    Raises:
        BadInput: there is neither steady sliding nor a hysteresis loop, or the stiffness is that of a wrong unit.
    """
    small = [i for i, m in enumerate(recorded.motions) if m.small]
    wide = [i for i in range(len(recorded.motions)) if i not in small]
    report("hysteresis loop")
    near = recorded.chosen(small)
    rest = [_without_elements(m, start, steady) for m in near.motions]
    branch = presliding.mean_branch(near.motions, near.usable, rest) if small else None
    if steady is None and branch is None:
        what = "there is neither steady sliding nor a hysteresis loop"
        names = ", ".join(m.name for m in recorded.motions)
        raise BadInput(what, names, "strokes at constant velocities both ways, or a small sine")
    criteria: dict[int, float] = {}
    slip, settle = FORGET, 0.0
    if branch is not None:
        ramps = presliding.ramps(branch)
        names = ", ".join(m.name for m in near.motions)
        check_unit("presliding stiffness", float(np.sum(ramps[1])), float(np.sum(rig.friction.element_stiffness)), names)
        start, criteria = _number_of_elements(near, start, ramps, elements, ["coulomb_force"] if steady is None else [])
        slip = 3.0 * float(np.max(ramps_of(start)[0]))
        settle = STEADY_LAGS * start.static_force / start.attraction_rate
    settle = max(settle, steady.settle_time if steady is not None else 0.0)
    counted = tuple(
        u if i in small else u & slides(m, slip, settle)
        for i, (m, u) in enumerate(zip(recorded.motions, recorded.usable, strict=True))
    )
    report("joint fit")
    recorded = recorded._replace(usable=counted)
    names = ", ".join(m.name for m in recorded.motions)
    settles = sum(int(counted[i].sum()) for i in wide) >= MIN_BLOCKS
    if not settles and branch is None:
        raise BadInput(f"no stroke slides on for the {settle:.2g} s in which friction settles", names, "longer strokes")
    slid = wide if steady is not None and settles else []
    fit = _fit_in_turn(recorded, start, small if branch is not None else [], slid)
    nodes = presliding.nodes(*ramps_of(fit.friction)) if branch is not None else []
    return ElementsFit(fit, branch, tuple(nodes), criteria, _remarks(fit, bool(slid), branch, criteria))


def _remarks(fit: JointFit, slid: bool, branch: presliding.Branch | None, criteria: Mapping[int, float]) -> tuple[str, ...]:
    out = []
    if not slid:
        out.append("Nothing slides steadily for long enough: of the Stribeck curve only its level is fitted.")
    if branch is None:
        out.append("No presliding is recorded: stiffness and weight of the elements are the rig file's.")
    if len(criteria) > 1:
        number = len(fit.friction.element_stiffness)
        change = {n: value - criteria[number] for n, value in sorted(criteria.items()) if n != number}
        others = ", ".join(f"{n}: {value:+.0f}" for n, value in change.items())
        plural = "element explains" if number == 1 else "elements explain"
        out.append(f"{number} friction {plural} the loop (change of the Bayesian information criterion with {others}).")
    return tuple(out)


def _number_of_elements(
    near: Recorded, start: Friction, ramps: tuple[Array, Array], elements: int | None, also: Sequence[str]
) -> tuple[Friction, dict[int, float]]:
    """Return the friction with the required or best-supported number of elements, and the criterion of each number tried.

    Args:
        near: recordings of presliding.
        start: friction to start from.
        ramps: ends [m] and stiffness [N/m] of the loop's ramps.
        elements: number of elements; None: as many as the data show.
        also: free coordinates beside those of the elements.
    """
    criteria: dict[int, float] = {}
    best = start
    for number in range(1, MAX_ELEMENTS + 1) if elements is None else [elements]:
        first = _best_rate(near, _with_elements(start, *presliding.merged(*ramps, number)))
        coordinates = ElementCoordinates(number)
        free = (*(name for name in coordinates.names if name not in STATIC), *also)
        trial = joint.fit(near, Start(coordinates, first, free), turned=presliding.corrected_turns, rounds=2)
        criteria[number] = _criterion(trial, near.motions)
        if number - 1 in criteria and criteria[number] > criteria[number - 1] - EVIDENCE:
            break  # no significant improvement
        best = trial.friction
    return best, criteria


def _without_elements(motion: Motion, start: Friction, steady: StaticFit | None) -> Array:
    """Return the known part of the force balance before the joint fit, without the friction elements [N]."""
    other: Array = start.viscous_coefficient * motion.velocity
    if steady is not None:
        names = list(steady.linear)
        other = other + linear_columns(motion, names) @ np.array([steady.linear[name] for name in names])
    return other


def _with_elements(start: Friction, ends: Array, stiffness: Array) -> Friction:
    """Return a friction with the elements of a branch's ramps, each with the limit force D_i k_i / 2."""
    order = np.argsort(ends)
    hold = (ends * stiffness)[order]
    return start._replace(
        element_stiffness=tuple(stiffness[order].tolist()), element_weight=tuple((hold / hold.sum()).tolist())
    )


def ramps_of(friction: Friction) -> tuple[Array, Array]:
    """Return ends [m] and stiffness [N/m] of the elements' ramps at standstill, shape (elements,) each."""
    stiffness = np.asarray(friction.element_stiffness)
    return 2.0 * np.asarray(friction.element_weight) * friction.static_force / stiffness, stiffness


def _best_rate(near: Recorded, start: Friction) -> Friction:
    """Return the friction with the attraction rate of :data:`RATES` that explains the recordings best."""

    def unexplained(friction: Friction) -> float:
        total = 0.0
        for motion, good in zip(near.motions, near.usable, strict=True):
            rows = linear_columns(motion, near.linear)[good]
            left = (motion.force - force_along(motion, MODEL, friction))[good]
            solution, *_ = np.linalg.lstsq(rows, left, rcond=1e-10)
            total += float(np.sum(np.abs(left - rows @ solution)))
        return total

    return min((start._replace(attraction_rate=float(rate)) for rate in RATES), key=unexplained)


def _criterion(trial: JointFit, motions: Sequence[Motion]) -> float:
    """Return the Bayesian information criterion of a fit with estimated noise variance."""
    squares = sum(float(np.nansum(r**2)) for r in trial.residuals)
    count = sum(int(np.sum(np.isfinite(r))) for r in trial.residuals)
    left_out = sum(int(m.resolved.sum()) for m in motions) - count
    # An omitted block costs as much as one at the limit.
    squares += left_out * (joint.FAR * max(trial.noise)) ** 2
    independent = max(trial.blocks, 2.0)
    return independent * float(np.log(squares / (count + left_out))) + len(trial.covariance) * float(np.log(independent))


def _fit_in_turn(recorded: Recorded, start: Friction, small: Sequence[int], wide: Sequence[int]) -> JointFit:
    """Fit the force balance and the Stribeck curve to sliding, then the elements to presliding.

    In presliding the sensor misses small motion at reversals. That hardly affects the elements, but would bias a Stribeck curve
    fitted to it.

    Args:
        recorded: the recordings.
        start: friction to start from.
        small: indices of the recordings of presliding.
        wide: indices of those of sliding.
    """
    coordinates: Coordinates = ElementCoordinates(len(start.element_stiffness))
    elements = tuple(name for name in coordinates.names if name not in STATIC)
    near, far, turned = recorded.chosen(small), recorded.chosen(wide), presliding.corrected_turns
    motions = recorded.motions
    if not small:
        return joint.placed(joint.fit(far, Start(coordinates, start, STATIC)), wide, motions)
    if not wide:
        sticking = joint.fit(near, Start(coordinates, start, ("coulomb_force", *elements)), turned=turned)
        return joint.placed(sticking, small, motions)
    sliding = joint.fit(far, Start(coordinates, start, STATIC))
    sticking = joint.fit(near, Start(coordinates, sliding.friction, elements), turned=turned)
    moved = joint.moved_with_held(sticking, near)
    return joint.combined(joint.placed(sliding, wide, motions), joint.placed(sticking, small, motions), moved)
