"""From recordings to a rig's friction: static fit, hysteresis loop, number of elements, and one fit of everything."""

import time as clock
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.identification import joint, presliding, static
from ehls_ros.identification.gms_force import elements_force, linear_columns
from ehls_ros.identification.motion import SMALL_TRAVEL, Motion, prepare, slope_noise
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.uncertainty import estimates
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask, noise
from ehls_ros.trajectory import Trajectory

DEFAULT_OPTIMISER = "pso"
"""The quickest on `benchmarks/optimisers.py`, with no failed run; least squares is the most exact."""

BLOCK_LENGTHS, BLOCKS = (0.005, 0.01, 0.02, 0.05, 0.1), 100_000
"""Lengths of a block [s], and how many blocks all recordings together are cut into at most while the longest allows it."""

BRANCH_BLOCKS, LONGEST_FINE = 80, 0.02
"""Blocks between two turns that resolve the hysteresis loop, and the longest block there [s]."""

SLOW, CLEAR = 0.1, 0.01
"""The velocity of a block is clear when its noise is below this part of the slowest tenth of the velocities."""

MOST_ELEMENTS = 4
"""Most friction elements that are tried."""

EVIDENCE = 100.0
"""By how much another element has to lower the Bayesian information criterion to be believed in.

Far more than chance asks for: what moves to and fro unseen at a reversal looks like one more element, too.
"""

RATES = np.geomspace(30.0, 3e4, 7)
"""Attraction rates C that are tried to start from [N/s]."""

MASS_SIGNAL = 10.0
"""Inertia force, in standard deviations of the force's noise, from which the mass is fitted."""

LAST_PART, LEAST_SETTLED = 0.4, 0.85
"""Part of a stroke that counts where it is short, and part of the settling time that it needs all the same."""

SETTLED = 6.0
"""Lags s/C of the slipping elements after which sliding counts as steady."""

FORGET = 3e-3
"""Way after a turn in which it is forgotten, where presliding was not recorded [m]."""

STEADY = 0.1
"""Part of Coulomb friction that the inertia of steady sliding may take."""

SOME_OUTLIERS = 1e-3
"""Part of a recording left out from which it is said."""

UNIT_FACTOR = 100.0
"""Factor by which friction or spring may differ from the rig file's before a wrong unit is suspected."""

STATIC = ("coulomb_force", "static_rise", "stribeck_velocity", "stribeck_exponent")

Progress = Callable[[str, int, int], None]


class Identification(NamedTuple):
    """What was found.

    Attributes:
        rig: the rig with the coefficients found.
        estimates: what the data say of each coefficient, by its name in the rig file.
        correlations: correlation of the estimates, shape (n, n), in their order.
        not_identifiable: names of what the data cannot tell, or tell apart.
        remarks: sentences about how far the result goes.
        static: the static fit, None without steady sliding.
        branch: the mean branch of the hysteresis loop, None without reversals in presliding.
        nodes: nodes of the branch.
        criteria: Bayesian information criterion by number of elements.
        fit: the joint fit.
        motions: the recordings in blocks.
        method: the optimiser of the static fit.
        wall_s: wall time [s].
    """

    rig: Rig
    estimates: Mapping[str, Estimate]
    correlations: Array
    not_identifiable: tuple[str, ...]
    remarks: tuple[str, ...]
    static: static.StaticFit | None
    branch: presliding.Branch | None
    nodes: tuple[presliding.Node, ...]
    criteria: Mapping[int, float]
    fit: joint.JointFit
    motions: tuple[Motion, ...]
    method: str
    wall_s: float


def identify(
    recordings: Mapping[str, Trajectory],
    rig: Rig,
    *,
    optimiser: str = DEFAULT_OPTIMISER,
    parameters: Any = None,
    elements: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Identify the friction of a rig.

    Args:
        recordings: by a name for messages; each with ``position_m`` and ``force_n`` or ``load_pressure_pa``.
        rig: the rig as known so far: mass, piston area and B0 are taken from it, friction is where the search starts.
        optimiser: of the static fit, a name of :data:`ehls_ros.identification.optimisers.OPTIMISERS`.
        parameters: its parameters; None: the declared defaults.
        elements: number of friction elements; None: as many as the data show.
        seed: seed of what is random in the search.
        progress: called with what is being done, what is done and what there is in all.

    Returns:
        The result.

    Raises:
        BadInput: the recordings cannot be used; the message names the signal.
    """
    began = clock.perf_counter()
    tell = progress or (lambda what, done, total: None)
    if not recordings:
        raise BadInput("there is no recording", "identification", "at least one recording")
    tell("reading the motion", 0, 4)
    recorded = _motions(recordings, rig)
    usable = [m.resolved & _state_known(m) if m.small else m.resolved for m in recorded]
    if not any(np.any(u) for u in usable):
        raise BadInput("no stretch of any recording can be used", ", ".join(recordings), "longer recordings without gaps")
    linear = _linear(recorded, rig)
    motions = [_without_the_known(m, linear, rig) for m in recorded]

    tell("static fit", 1, 4)
    chosen = parameters if parameters is not None else OPTIMISERS.load(optimiser).Parameters()
    # Steady sliding has no inertia to speak of: its mass is the rig file's.
    straight = [name for name in linear if name not in ("viscous", "mass")]
    slow = [_is_steady(m, rig) for m in motions]
    small = [i for i, m in enumerate(motions) if m.small]
    wide = [i for i in range(len(motions)) if i not in small]
    steady = static.steady_fit(
        [_without_the_known(recorded[i], straight, rig) for i in wide],
        [usable[i] & slow[i] for i in wide],
        straight,
        rig.plant.viscous_damping,
        optimiser,
        chosen,
        seed,
    )
    start = _start(rig, steady)
    _check_units(", ".join(recordings), rig, steady)

    tell("hysteresis loop", 2, 4)
    rest = [_rest(motions[i], start, steady) for i in small]
    branch = presliding.mean_branch([motions[i] for i in small], [usable[i] for i in small], rest) if small else None
    if steady is None and branch is None:
        what = "there is neither steady sliding nor a hysteresis loop"
        raise BadInput(what, ", ".join(recordings), "strokes at constant velocities both ways, or a small sine")
    criteria: dict[int, float] = {}
    number = len(start.element_stiffness)
    starts = {number: start}
    if branch is not None:
        ends, stiffness = presliding.ramps(branch)
        _check_stiffness(", ".join(motions[i].name for i in small), rig, float(np.sum(stiffness)))
        counts = range(1, MOST_ELEMENTS + 1) if elements is None else [elements]
        starts = {n: _with_elements(start, *presliding.merged(ends, stiffness, n)) for n in counts}
        near, masks = [motions[i] for i in small], [usable[i] for i in small]
        for n in counts:
            first = _best_rate(near, masks, starts[n], linear)
            free = [name for name in joint.Layout(n).names if name not in STATIC]
            if steady is None:
                free.append("coulomb_force")
            trial = joint.fit(near, masks, first, linear, free=free, turning=True, rounds=2)
            starts[n], criteria[n] = trial.friction, _criterion(trial, near)
            if n - 1 in criteria and criteria[n] > criteria[n - 1] - EVIDENCE:
                break  # one more did not help
            number = n

    tell("joint fit", 3, 4)
    slip = 3.0 * float(np.max(_ramps_of(starts[number])[0])) if branch is not None else FORGET
    lag = starts[number].static_force / starts[number].attraction_rate if branch is not None else 0.0
    settle = max(SETTLED * lag, steady.settle_time if steady is not None else 0.0)
    counted = [
        u if i in small else u & _sliding_long(m, slip, settle) for i, (m, u) in enumerate(zip(motions, usable, strict=True))
    ]
    fit = _fit_in_turn(motions, counted, starts[number], linear, small if branch is not None else [], wide if steady else [])
    found = estimates(fit, rig)
    remarks = [*_remarks(motions, steady is not None, branch is not None, criteria, number), *found.remarks]
    tell("done", 4, 4)
    node_list = presliding.nodes(*_ramps_of(fit.friction)) if branch is not None else []
    return Identification(
        rig=found.rig,
        estimates=found.by_name,
        correlations=found.correlations,
        not_identifiable=found.not_identifiable,
        remarks=tuple(remarks),
        static=steady,
        branch=branch,
        nodes=tuple(node_list),
        criteria=criteria,
        fit=fit,
        motions=tuple(motions),
        method=optimiser,
        wall_s=clock.perf_counter() - began,
    )


def _motions(recordings: Mapping[str, Trajectory], rig: Rig) -> list[Motion]:
    total = sum(float(t.time_s[-1] - t.time_s[0]) for t in recordings.values() if len(t) > 1)
    shortest = min(total / BLOCKS, BLOCK_LENGTHS[-1])
    return [prepare(t, rig, name, _block_length(t, shortest)) for name, t in recordings.items()]


def _travel(trajectory: Trajectory) -> float:
    """Return how far the piston goes, stray samples aside [m]."""
    position = trajectory.signals.get("position_m", np.zeros(1))
    position = position[np.isfinite(position)]
    return float(np.ptp(np.quantile(position, [0.01, 0.99]))) if position.size else 0.0


def _block_length(trajectory: Trajectory, shortest: float) -> float:
    """Return the shortest block in which the velocity is clear of the position's noise [s]."""
    position = trajectory.signals.get("position_m", np.zeros(0))
    position = position[np.isfinite(position)]
    if len(position) < 100:
        return BLOCK_LENGTHS[0]
    sample = float(np.median(np.diff(trajectory.time_s)))
    stride = max(1, round(BLOCK_LENGTHS[-1] / sample))
    speed = np.abs(np.diff(position[::stride])) / (stride * sample)
    if _travel(trajectory) < SMALL_TRAVEL:
        passes = np.count_nonzero(np.diff(position[::stride] > np.median(position)))
        branch = (trajectory.time_s[-1] - trajectory.time_s[0]) / max(1, passes)
        fine = [length for length in BLOCK_LENGTHS if branch >= BRANCH_BLOCKS * length and length <= LONGEST_FINE]
        return max(fine[-1] if fine else BLOCK_LENGTHS[0], sample)
    moving = speed[speed > 0.1 * np.median(speed)]
    slow = float(np.quantile(moving, SLOW)) if moving.size else 0.0
    per_sample = noise(position)
    for length in BLOCK_LENGTHS:
        block = max(length, sample)
        if length >= shortest and slope_noise(per_sample / np.sqrt(block / sample), block) < CLEAR * slow:
            return block
    return max(BLOCK_LENGTHS[-1], sample)


def _state_known(motion: Motion) -> Mask:
    """Tell which blocks come after the second turn of their stretch: by then every element has slipped once."""
    at_start = np.maximum.accumulate(np.where(motion.fresh, motion.strokes, 0))
    known: Mask = motion.strokes - at_start >= 2
    return known


def _linear(motions: Sequence[Motion], rig: Rig) -> list[str]:
    """Return which straight-line coefficients the recordings have something to say of."""
    names = ["viscous"]
    widest = max(float(np.ptp(m.position[m.resolved])) for m in motions if np.any(m.resolved)) if motions else 0.0
    if rig.plant.spring_stiffness > 0.0 and widest > SMALL_TRAVEL:
        names.append("spring")
    names.append("constant")
    inertia = max(
        float(np.std(m.acceleration[m.resolved])) * rig.plant.moving_mass / max(m.force_noise, 1e-9)
        for m in motions
        if np.any(m.resolved)
    )
    if inertia > MASS_SIGNAL:
        names.append("mass")
    return names


def _without_the_known(motion: Motion, linear: Sequence[str], rig: Rig) -> Motion:
    """Take off what the rig file says of spring and mass where the recordings do not say it."""
    force = motion.force.copy()
    if "spring" not in linear:
        force -= rig.plant.spring_stiffness * motion.position
    if "mass" not in linear:
        force -= rig.plant.moving_mass * motion.acceleration
    return motion._replace(force=force)


def _sliding_long(motion: Motion, way: float, time: float) -> Mask:
    """Tell which blocks of a wide motion slide, after a way [m] and a time [s] in which the turn before is forgotten.

    Long blocks smear a turn; what the elements do there is for the recordings of presliding to tell.
    """
    stroke = motion.strokes
    start = np.searchsorted(stroke, stroke)
    time_since = (np.arange(len(stroke)) - start) * motion.period
    way_since = np.abs(motion.position - motion.position[start])
    lasts = np.bincount(stroke) * motion.period
    # Strokes too short for the time count with their last part, unless that is still settling.
    needed = np.clip((1.0 - LAST_PART) * lasts, LEAST_SETTLED * time, time)[stroke]
    moves = np.abs(motion.velocity) > 5.0 * motion.velocity_noise
    long: Mask = moves & (way_since >= way) & (time_since >= needed)
    return long


def _is_steady(motion: Motion, rig: Rig) -> Mask:
    """Tell which blocks hardly accelerate: what inertia takes is small against friction."""
    steady: Mask = rig.plant.moving_mass * np.abs(motion.acceleration) <= STEADY * rig.friction.coulomb_force
    return steady


def _start(rig: Rig, steady: static.StaticFit | None) -> Friction:
    """Return the friction the search starts from: the rig file's, and where there is a static fit, that."""
    if steady is None:
        return rig.friction
    found = steady.friction
    return rig.friction._replace(
        coulomb_force=max(found.coulomb_force, 1e-3 * rig.friction.coulomb_force),
        static_force=max(found.static_force, found.coulomb_force, 1e-3 * rig.friction.coulomb_force),
        stribeck_velocity=found.stribeck_velocity,
        stribeck_exponent=found.stribeck_exponent,
        viscous_coefficient=found.viscous_coefficient,
    )


def _check_units(names: str, rig: Rig, steady: static.StaticFit | None) -> None:
    """Refuse what only a wrong unit explains, now that the signals have been put together."""
    if steady is None:
        return
    pairs = [("friction", steady.friction.coulomb_force, rig.friction.coulomb_force)]
    if "spring" in steady.linear:
        pairs.append(("spring", steady.linear["spring"], rig.plant.spring_stiffness))
    for what, found, known in pairs:
        ratio = abs(found) / known
        if not 1.0 / UNIT_FACTOR < ratio < UNIT_FACTOR:
            raise BadInput(
                f"force_n and position_m make the {what} {found:.3g}, {ratio:.2g} times the rig file's {known:.3g}",
                names,
                "SI units, N and m (see --columns), or a rig file with a closer guess",
            )


def _check_stiffness(names: str, rig: Rig, found: float) -> None:
    """Refuse a presliding stiffness that only a wrong unit explains."""
    known = float(np.sum(rig.friction.element_stiffness))
    if not 1.0 / UNIT_FACTOR < found / known < UNIT_FACTOR:
        raise BadInput(
            f"force_n and position_m make the presliding stiffness {found:.3g} N/m, the rig file's is {known:.3g} N/m",
            names,
            "SI units, N and m (see --columns), or a rig file with a closer guess",
        )


def _rest(motion: Motion, start: Friction, steady: static.StaticFit | None) -> Array:
    """Return the force balance without the friction elements, as far as it is known before the joint fit."""
    other = start.viscous_coefficient * motion.velocity
    if steady is not None:
        names = list(steady.linear)
        other = other + linear_columns(motion, names) @ np.array([steady.linear[name] for name in names])
    return other


def _with_elements(start: Friction, ends: Array, stiffness: Array) -> Friction:
    """Return a friction with the elements a branch shows: D_i k_i / 2 is what each holds."""
    order = np.argsort(ends)
    hold = (ends * stiffness)[order]
    return start._replace(
        element_stiffness=tuple(float(k) for k in stiffness[order]),
        element_weight=tuple(float(a) for a in hold / hold.sum()),
    )


def _best_rate(motions: Sequence[Motion], usable: Sequence[Mask], start: Friction, linear: Sequence[str]) -> Friction:
    """Return the friction with the attraction rate that explains the recordings best, of a few."""

    def unexplained(friction: Friction) -> float:
        total = 0.0
        for motion, good in zip(motions, usable, strict=True):
            rows = linear_columns(motion, linear)[good]
            left = (motion.force - elements_force(motion, friction))[good]
            solution, *_ = np.linalg.lstsq(rows, left, rcond=1e-10)
            total += float(np.sum(np.abs(left - rows @ solution)))
        return total

    return min((start._replace(attraction_rate=float(rate)) for rate in RATES), key=unexplained)


def _criterion(trial: joint.JointFit, motions: Sequence[Motion]) -> float:
    """Return the Bayesian information criterion with a noise that has to be estimated."""
    squares = sum(float(np.nansum(r**2)) for r in trial.residuals)
    count = sum(int(np.sum(np.isfinite(r))) for r in trial.residuals)
    left_out = sum(int(m.resolved.sum()) for m in motions) - count
    # A block left out as too far off costs what one just not left out would.
    squares += left_out * (joint.FAR * max(trial.noise)) ** 2
    independent = max(trial.blocks, 2.0)
    return independent * float(np.log(squares / (count + left_out))) + len(trial.covariance) * float(np.log(independent))


def _fit_in_turn(
    motions: Sequence[Motion],
    counted: Sequence[Mask],
    start: Friction,
    linear: Sequence[str],
    small: Sequence[int],
    wide: Sequence[int],
) -> joint.JointFit:
    """Fit the force balance and the Stribeck curve to sliding, then the elements to presliding.

    In presliding the piston moves to and fro by less than a sensor resolves. That hardly matters for the elements,
    but a Stribeck curve fitted to it as well would be drawn away from what steady sliding says surely.
    """

    def chosen(which: Sequence[int]) -> tuple[list[Motion], list[Mask]]:
        return [motions[i] for i in which], [counted[i] for i in which]

    elements = [name for name in joint.Layout(len(start.element_stiffness)).names if name not in STATIC]
    if not small:
        return joint.fit(*chosen(wide), start, linear, free=STATIC)
    if not wide:
        return joint.fit(*chosen(small), start, linear, free=["coulomb_force", *elements], turning=True)
    sliding = joint.fit(*chosen(wide), start, linear, free=STATIC)
    presliding_fit = joint.fit(*chosen(small), sliding.friction, linear, free=elements, turning=True)
    return joint.combined(sliding, presliding_fit, wide, small)


def _ramps_of(friction: Friction) -> tuple[Array, Array]:
    stiffness = np.asarray(friction.element_stiffness)
    return 2.0 * np.asarray(friction.element_weight) * friction.static_force / stiffness, stiffness


def _remarks(
    motions: Sequence[Motion], slides: bool, presliding_seen: bool, criteria: Mapping[int, float], number: int
) -> list[str]:
    out = []
    if not slides:
        out.append("Nothing slides steadily: of the Stribeck curve only its level is fitted, the rest is the rig file's.")
    if not presliding_seen:
        out.append("No presliding is recorded: stiffness and weight of the elements are the rig file's.")
    if criteria and len(criteria) > 1:
        others = ", ".join(f"{n}: {criteria[n] - criteria[number]:+.0f}" for n in sorted(criteria) if n != number)
        plural = "element explains" if number == 1 else "elements explain"
        out.append(f"{number} friction {plural} the loop (Bayesian information criterion against other numbers {others}).")
    out.extend(
        f"{m.name}: {100.0 * m.outliers:.1f} % of the samples were outliers or missing and left out."
        for m in motions
        if m.outliers > SOME_OUTLIERS
    )
    return out
