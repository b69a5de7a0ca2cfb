"""Identification of all coefficients of a rig: a starting point stage by stage, then each independent block with its errors.

The residuals are those of a diagnosis (:mod:`ehls_ros.diagnosis.stages`), in units of their noise floor.
"""

import math
import time as clock
from collections.abc import Callable, Collection, Container, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.coefficients import RelativeErrors, kept
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.record import FORCE, POSITION, PRESSURE, SPOOL, SUPPLY, VELOCITY, Record, prepare
from ehls_ros.diagnosis.stages import Channel, Setup, setup
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.identification.rig_coefficients import (
    COULOMB,
    DELAY,
    EDGE_GAINS,
    LOAD,
    OPTIONAL,
    SECOND_ORDER,
    SENSORS,
    SHAPES,
    STATIC,
    Coefficient,
    acting,
    coefficients,
    effect_of,
    model_at,
    placed,
    read,
    uses,
    with_ratio,
    without,
)
from ehls_ros.identification.rig_fit import RigFit, Stack, fit
from ehls_ros.identification.rig_identifiability import (
    FORM_WINDOWS,
    FORM_WINDOWS_OF_ABSENT,
    Estimated,
    estimated,
    unidentifiable,
)
from ehls_ros.identification.rig_noise import corrected, gain, rounding, with_added_noise
from ehls_ros.identification.rig_result import ChannelFit, RigIdentification
from ehls_ros.identification.rig_stages import (
    BANDWIDTH,
    DISCHARGE,
    MIN_SIGMAS,
    OF_SENSORS,
    SEARCHED,
    SUPPLY_PRESSURE,
    Block,
    blocks,
    effective,
    sizes,
    stage_by_stage,
    without_signals,
)
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import Rig, check_known
from ehls_ros.trajectory import Trajectory

CONTRADICTS = 20.0
"""Increase of the loss above which a given value of a coefficient contradicts the data [nats]."""

CONTRADICTED = "the given value contradicts the data, and one that fits is kept"

MOVING = (SPOOL, PRESSURE, POSITION, VELOCITY, FORCE)
"""Signals that are never constant throughout a recording if their sensor works."""

REST = 12.0
"""Range of the position over its noise up to which the piston rests; white noise alone spans 8 in 20 000 samples."""

LONGEST_FIT = 0.05
"""Longest local fit of the motion [s]: a slow stroke, which shows the break-away of friction, hardly turns within it."""

GUESS_FACTOR = 2.0
"""Factor by which a first guess may be off."""

ROUNDS = 5
"""Maximum number of refits after dropping insignificant or unidentifiable coefficients."""

STEPS, DONE = 3, "done"
"""Number of progress steps, and the name of the last report."""

Progress = Callable[[str, int, int], None]


def identify_rig(
    recordings: Mapping[str, Trajectory],
    rig: Rig,
    *,
    seed: int = 0,
    progress: Progress = lambda what, done, total: None,
) -> RigIdentification:
    """Identify all coefficients of a rig that recordings determine.

    Args:
        recordings: by a name for messages, each with any of the data contract's signals.
        rig: the first guess, which may be off by a factor of two. Coefficients known only in combination with others, such as
            piston area and volume, are taken from it (:func:`ehls_ros.diagnosis.coefficients.kept`), and so are the
            friction model and the weights of its elements.
        seed: of the noise added to estimate the noise floor.
        progress: called with the name of the step that begins, the steps done and the number of steps.

    Returns:
        The result; after a numerical failure, the given rig with a remark.

    Raises:
        BadInput: there is no recording, or none that can be one of such a rig.
    """
    began = clock.perf_counter()
    progress("reading the recordings", 0, STEPS)
    records, remarks = _records(recordings, rig)
    names = tuple(record.name for record in records)
    try:
        # Without any noise the noise floor is zero; residuals divided by it are clipped.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found = _identified(records, rig, seed, progress)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        what = f"the numbers do not work out ({error}): nothing is identified"
        found = RigIdentification(rig, {}, np.empty((0, 0)), np.empty((0, 0)), {}, kept(rig), {}, names, (what,), 0.0)
    progress(DONE, STEPS, STEPS)
    return found._replace(recordings=names, remarks=(*remarks, *found.remarks), wall_s=clock.perf_counter() - began)


def _records(recordings: Mapping[str, Trajectory], rig: Rig) -> tuple[list[Record], list[str]]:
    """Return the usable recordings, and remarks on all of them."""
    if not recordings:
        raise BadInput("there is no recording", "identification", "at least one recording")
    check_known(rig, "identification of the whole rig")
    records, remarks, refused = list[Record](), list[str](), list[BadInput]()
    for name, trajectory in recordings.items():
        stuck = [signal for signal in MOVING if signal in trajectory and _is_stuck(trajectory[signal])]
        remarks += [f"{name}: {signal} is stuck at one value and is left out" for signal in stuck]
        left = {signal: values for signal, values in trajectory.signals.items() if signal not in stuck}
        try:
            record = prepare(Trajectory(trajectory.time_s, left), rig, name)
        except BadInput as error:
            refused.append(error)
            remarks.append(f"{name} is left out: {error}")
            continue
        records.append(record)
        remarks += [f"{name}: {remark}" for remark in record.remarks]
    if not records:
        raise refused[0]
    return records, remarks


def _is_stuck(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    return finite.size > 0 and float(np.ptp(finite)) == 0.0


def _identified(records: Sequence[Record], rig: Rig, seed: int, progress: Progress) -> RigIdentification:
    stack = _stack(records, rig, seed)
    known = {c.path: c for c in coefficients(rig, sizes(records, rig))}
    missing = without_signals(records, stack, known)
    free = {path: c for path, c in known.items() if path not in missing}
    least = _least(records)

    progress("stage by stage", 1, STEPS)
    own = [free.pop(path) for path in SENSORS if path in free]
    sensors = _fitted(stack.only(OF_SENSORS), rig, rig, own, OF_SENSORS, least, {})
    model, spread = stage_by_stage(stack, sensors.rig, free, records)
    spread = {**spread, **_rounding_of_supply(records, rig)}

    progress("standard errors", 2, STEPS)
    # The noise floor depends on the model, and the first guess was far off.
    stack = _stack(records, model, seed)
    lost = without_signals(records, stack, free)
    model, missing = _restored(model, rig, list(lost)), {**missing, **lost}
    parts = list[_Fitted]()
    for block in blocks(stack, [path for path in free if path not in lost]):
        of_block = _valve_of(model, stack.only(block.channels))
        part = _fitted(of_block, rig, model, _of_block(block, free, model), block.channels, least, spread)
        if SECOND_ORDER[0] in part.not_identifiable:
            model = acting(without(model, SECOND_ORDER))
            part = _fitted(of_block, rig, model, _of_block(block, free, model), block.channels, least, spread)
        parts.append(part)
        model = part.rig
    parts.append(sensors)
    if uses(model, SECOND_ORDER[0]):
        missing[BANDWIDTH] = f"the spool follows {SECOND_ORDER[0]}"

    covariance = scipy.linalg.block_diag(*(part.covariance for part in parts))
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return RigIdentification(
        rig=model,
        estimates={path: estimate for part in parts for path, estimate in part.estimates.items()},
        covariance=covariance,
        correlations=np.clip(covariance / np.outer(std, std), -1.0, 1.0),
        absent={path: estimate for part in parts for path, estimate in part.absent.items()},
        not_identifiable={
            **missing,
            **{path: why for part in parts for path, why in part.not_identifiable.items()},
            **kept(rig),
        },
        channels=_channels(stack, rig, model),
        recordings=(),
        remarks=() if all(part.converged for part in parts) else ("the fit had not converged after its last step",),
        wall_s=0.0,
        errors=RelativeErrors(
            tuple(name for part in parts for name in part.errors.names),
            scipy.linalg.block_diag(*(part.errors.covariance for part in parts)),
            frozenset().union(*(part.errors.identified for part in parts)),
        ),
    )


def _of_block(block: Block, free: Mapping[str, Coefficient], model: Rig) -> list[Coefficient]:
    """Return the coefficients of a block, of the optional ones those that a model has."""
    used = effective([free[path] for path in block.paths if path not in OPTIONAL or uses(model, path)])
    second = uses(model, SECOND_ORDER[0])
    # Left out, an insignificant delay would give a wrong natural frequency for certain.
    return [c._replace(neutral=None) if second and c.path == DELAY else c for c in used]


def _stack(records: Sequence[Record], rig: Rig, seed: int) -> Stack:
    # With too high a guess of the bandwidth, the command would seem to be sampled too slowly.
    slow = placed(rig, {BANDWIDTH: read(rig, BANDWIDTH) / GUESS_FACTOR})
    setups = [(record, _without_rest(record, setup(record, slow, LONGEST_FIT))) for record in records]
    return _valve_of(rig, Stack([gather(record, rig, compared, seed) for record, compared in setups if compared.channels]))


def _without_rest(record: Record, compared: Setup) -> Setup:
    """Return a setup without the force balance if the piston rests: noise of the motion would pass for inertia and friction."""
    if POSITION not in record or float(np.ptp(record.signals[POSITION])) > REST * record.noise[POSITION]:
        return compared
    return compared._replace(channels=tuple(c for c in compared.channels if c != "force"))


def _valve_of(rig: Rig, stack: Stack) -> Stack:
    """Return a stack whose spool moves between samples as the valve of a rig."""
    valve = rig.effective()
    return Stack([replace(e, setup=e.setup._replace(valve=e.setup.valve and valve)) for e in stack.evidences])


def _least(records: Sequence[Record]) -> dict[str, float]:
    """Return the least relevant biases: the noise of the sensor in which each would show."""

    def noise(signal: str) -> float:
        return max((record.noise[signal] for record in records if signal in record), default=0.0)

    return {
        "effects.valve_null_bias.command": noise(SPOOL),
        "effects.valve_null_bias.opening": noise(SPOOL),
        "sensors.force.bias": noise(FORCE),
        "sensors.velocity.bias": noise(VELOCITY),
    }


def _rounding_of_supply(records: Sequence[Record], rig: Rig) -> dict[str, float]:
    """Return the standard errors of coordinates by rounding of the supply pressure, the same in all readings of a constant.

    The flow is proportional to the root of the pressure, so half of its relative error returns in the flow gains.
    """
    if not any(SUPPLY in record for record in records):
        return {}
    rounded = rig.sensors.get("supply_pressure", Sensor()).resolution / math.sqrt(12.0) / rig.plant.supply_pressure
    return {SUPPLY_PRESSURE: rounded, **dict.fromkeys((DISCHARGE, *EDGE_GAINS), 0.5 * rounded)}


class _Fitted(NamedTuple):
    """Result of a fit of some coefficients.

    Attributes:
        rig: the rig with them.
        estimates: the identified coefficients.
        covariance: of these, shape (n, n).
        not_identifiable: the coefficients that are not identifiable, with the reason.
        absent: those not significantly different from none.
        converged: whether the fit has converged.
        errors: of all coefficients.
    """

    rig: Rig
    estimates: Mapping[str, Estimate]
    covariance: Array
    not_identifiable: Mapping[str, str]
    absent: Mapping[str, Estimate]
    converged: bool
    errors: RelativeErrors


def _fitted(
    stack: Stack,
    given: Rig,
    start: Rig,
    chosen: Sequence[Coefficient],
    channels: Collection[Channel],
    least: Mapping[str, float],
    spread: Mapping[str, float],
) -> _Fitted:
    """Fit coefficients, restore the given values of unidentifiable ones, and drop those not significantly different from none.

    The result is corrected for the noise in the fit's derivatives.

    Args:
        stack: the recordings.
        given: the given rig.
        start: starting point of the fit.
        chosen: the coefficients.
        channels: the residuals to fit to.
        least: least relevant biases, by path.
        spread: further standard errors of coordinates, by path.
    """
    fitted, absent = list(chosen), dict[str, Estimate]()
    now = fit(stack, start, fitted, channels)
    reasons, doubtful, moved = dict[str, str](), list[Coefficient](), dict[str, float]()

    def with_doubtful() -> RigFit:
        return fit(stack, now.rig, [*doubtful, *fitted], channels, iterations=0) if doubtful else now

    for _ in range(ROUNDS):
        found = estimated(stack, with_doubtful(), len(doubtful), spread, form_windows=FORM_WINDOWS_OF_ABSENT)
        none = {
            c.path: c.neutral
            for c in fitted
            if c.neutral is not None and _is_insignificant(c, found.by_path[c.path], given, least)
        }
        if none:
            absent |= {path: found.by_path[path] for path in none}
            fitted = _left(fitted, none)
            now = fit(stack, placed(now.rig, none), fitted, channels)
            continue
        found_unidentifiable = () if doubtful else unidentifiable(stack, now, {c.path: i for i, c in enumerate(chosen)})
        if not found_unidentifiable:
            break
        reasons = {d.path: d.reason for d in found_unidentifiable}
        doubtful = [c for c in fitted if c.path in reasons]
        fitted = [c for c in fitted if c.path not in reasons]
        again = fit(stack, _restored(now.rig, given, list(reasons)), fitted, channels)
        if again.comparable > now.comparable + CONTRADICTS:
            # Restore the coefficients without influence on the residuals; of a combination, keep the values that fit.
            unseen = [d.path for d in found_unidentifiable if not d.excited]
            again = fit(stack, _restored(now.rig, given, unseen), fitted, channels)
            reasons |= {d.path: f"{d.reason}; {CONTRADICTED}" for d in found_unidentifiable if d.excited}
        moved = _moved(stack, again, doubtful, channels)
        now = again
    if LOAD in absent and given.plant.gravity:
        # Taken as zero for certain, a constant load would give the mass by its weight.
        doubtful.append(next(c for c in chosen if c.path == LOAD))
    noisy = with_added_noise(stack)
    free_of_noise = corrected(stack, now, noisy)
    converged, now = now.converged, free_of_noise.fit
    whole = with_doubtful()
    rounded = rounding(stack, now)
    further = {
        p: math.hypot(spread.get(p, 0.0), moved.get(p, 0.0), error, rounded[p]) for p, error in free_of_noise.spread.items()
    }
    response = gain(whole, noisy, len(doubtful)) if doubtful else free_of_noise.gain
    found = estimated(stack, whole, len(doubtful), {**spread, **further}, response, form_windows=FORM_WINDOWS)
    vague = [c.path for c in fitted if c.path in found.vague]
    because = f" as long as {', '.join(reasons)} are not" if reasons else ""
    reasons |= dict.fromkeys(vague, f"its standard error is large{because}; the value that fits is kept")
    kept = [i for i, c in enumerate(whole.chosen) if c.path not in reasons and c.path not in absent]
    estimates = {whole.paths[i]: found.by_path[whole.paths[i]] for i in kept}
    covariance, errors = found.covariance[np.ix_(kept, kept)], _relative_errors(found, whole.paths, estimates)
    return _Fitted(now.rig, estimates, covariance, reasons, absent, converged, errors)


def _relative_errors(found: Estimated, paths: Sequence[str], identified: Container[str]) -> RelativeErrors:
    """Return the errors of coefficients, in the order of ``paths``, but for those of effects and sensors."""
    values = {i: found.by_path[path].value for i, path in enumerate(paths) if not path.startswith(("effects.", "sensors."))}
    own = [i for i, value in values.items() if value != 0.0]
    of_one = np.array([1.0 / values[i] for i in own])
    names = {i: paths[i].split(".")[1] for i in own}
    known = frozenset(name for i, name in names.items() if paths[i] in identified)
    return RelativeErrors(tuple(names.values()), found.covariance[np.ix_(own, own)] * np.outer(of_one, of_one), known)


def _moved(stack: Stack, fitted: RigFit, doubtful: Sequence[Coefficient], channels: Collection[Channel]) -> dict[str, float]:
    """Return by path the change of the coordinates when others that are not fitted change by :data:`GUESS_FACTOR`.

    The propagation by derivatives is too small where the fit is not linear. Values that contradict the data do not count.
    """
    far = np.zeros(len(fitted.z))
    positive = [c for c in doubtful if c.scale == 0.0]
    for c, step in product(positive, (math.log(GUESS_FACTOR), -math.log(GUESS_FACTOR))):
        z = min(max(c.coordinate(fitted.rig) + step, c.low), c.high)
        other = fit(stack, model_at(fitted.rig, [c], [z]), fitted.chosen, channels, SEARCHED)
        if other.comparable <= fitted.comparable + CONTRADICTS:
            far = np.maximum(far, np.abs(other.z - fitted.z))
    return dict(zip(fitted.paths, far.tolist(), strict=True))


def _left(fitted: Sequence[Coefficient], none: Container[str]) -> list[Coefficient]:
    """Return the coefficients left without insignificant ones; an effect's shape goes with its size."""
    gone = {effect_of(c.path) for c in fitted if c.path in none}
    return [c for c in fitted if c.path not in none and not (c.path in SHAPES and effect_of(c.path) in gone)]


def _is_insignificant(c: Coefficient, found: Estimate, given: Rig, least: Mapping[str, float]) -> bool:
    """Return whether an optional coefficient is insignificant and absent from the given rig."""
    if c.neutral is None or read(given, c.path) != c.neutral:
        return False
    return abs(found.value - c.neutral) < max(MIN_SIGMAS * found.std, least.get(c.path, 0.0))


def _restored(rig: Rig, given: Rig, paths: Sequence[str]) -> Rig:
    """Return a rig with the given values of some coefficients restored; static friction keeps its ratio to Coulomb friction."""
    values = {path: read(given, path) for path in paths}
    if STATIC in values and COULOMB not in values:
        values[STATIC] *= read(rig, COULOMB) / read(given, COULOMB)
    return placed(rig, with_ratio(rig, values))


def _channels(stack: Stack, before: Rig, after: Rig) -> dict[Channel, ChannelFit]:
    rigs = [[r.values for r in stack.residuals(rig)] for rig in (before, after)]
    noise: list[Mapping[Channel, Array]] = [{c: np.ones(len(f)) for c, f in e.floor.items()} for e in stack.evidences]
    return {c: ChannelFit(*(_nrmse(stack, values, c) for values in (*rigs, noise))) for c in stack.channels}


def _nrmse(stack: Stack, residuals: Sequence[Mapping[Channel, Array]], channel: Channel) -> float:
    """Return the rms over all recordings, as a fraction of the largest term of the balance."""
    total, count = 0.0, 0
    for e, r in zip(stack.evidences, residuals, strict=True):
        if channel in e.channels:
            # Without a balance, the evidence holds no size of the velocity.
            size = e.sizes[channel] or float(np.sqrt(np.mean(e.record.values(VELOCITY) ** 2))) or 1.0
            total += float(np.sum((r[channel] * e.floor[channel] / size) ** 2))
            count += len(e.block[channel])
    return math.sqrt(total / count)
