"""Search for the experiment that best separates the causes left open by a diagnosis.

Every experiment of :data:`~ehls_ros.experiments.catalogue.CATALOGUE` is simulated with each candidate's rig as the plant, under
the same controller, which is designed with the nominal rig. These closed loops are not compared directly: under feedback any
two rigs agree in the controlled signals and differ in the others, and a moment of sticking changes the further course. Instead,
the criterion is how well one candidate's model **explains the record** of another. The model is simulated along the record with
the same valve commands and disturbance. Valve and cylinder integrate, so no force restores the position. The position is
therefore drawn to the recorded one with the time constant :data:`~ehls_ros.experiments.separation.MEMORY`. This is a prediction
over a moving window. An error of the force balance appears in the pressure, one of the flow in the position (as wrong travel
within the memory), one of the valve in the spool.

Means over blocks, which are insensitive to shifts of a millisecond, are divided by the noise floor of sensors and model. It
comprises noise and resolution, the error of the best model of a rig, and the effect of an unknown null of the valve. The last
is large where the piston sticks and a small flow builds up pressure. The start is excluded until friction no longer depends on
its initial state, which is unknown on a real rig. The part of the difference that the candidate could explain by other
parameter values is subtracted, since all data will be fitted together: the criterion of T-optimal design (Atkinson, Fedorov,
Biometrika 62, 1975). This fit is by least squares, linear around the given values, with their standard deviation by the data so
far as a prior. The root of the sum of squares is the separation in sigma. Of a pair's two directions the smaller one is used,
as the true cause is unknown, and the smallest of all pairs ranks the experiment. An experiment is not proposed if a candidate's
loop leaves the rig's limits or does not follow its reference.

A cause that acts only through the displacement of a position servo (``coupling_stiffness``) is not excited: the loads of the
catalogue are forces.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controller import controller_kernel
from ehls_ros.control.controllers import fasmc, pid
from ehls_ros.control.controllers.base import STATUS_SIZE, Model, model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import FORCE as LOAD
from ehls_ros.control.friction_estimator import observer_kernel
from ehls_ros.control.local_plant import memory_on
from ehls_ros.control.observers import ANY_MODEL, rig_model
from ehls_ros.control.observers.base import ObserverState
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments.catalogue import CATALOGUE, catalogue_spec, reach
from ehls_ros.experiments.loop import plant_of, sampled
from ehls_ros.experiments.separation import (
    BLOCK,
    MEMORY,
    MODEL_ERROR,
    NULL_ERROR,
    SETTLING,
    Difference,
    block_means,
    scale_of,
    start_of,
    stepped_rigs,
    unexplained,
)
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.plant import TEMPERATURE, X
from ehls_ros.physics.rig import EVERY_SENSED, SENSED, Rig, rig_to_mapping
from ehls_ros.physics.sensors import FORCE, LOAD_PRESSURE, POSITION, SPOOL, VELOCITY
from ehls_ros.physics.simulator import Constants, Simulated, State, plant_kernel

MIN_SIGMA = 5.0
"""Separation below which an experiment is not proposed."""

RECORDED, RECORDED_IN_CHAMBERS = (
    ("position", "load_pressure", "spool_position", "force"),
    ("position", "pressure_a", "pressure_b", "spool_position", "force"),
)
"""Signals recorded by default, on a cylinder with one pressure and with two; names of a rig file's sensors."""

NAMES = {
    "position": (f"position {1e3 * MEMORY:.0f} ms ahead", "mm", 1e3),
    "velocity": ("velocity", "mm/s", 1e3),
    "load_pressure": ("load pressure", "bar", 1e-5),
    "pressure_a": ("pressure in A", "bar", 1e-5),
    "pressure_b": ("pressure in B", "bar", 1e-5),
    "spool_position": ("spool displacement", "µm", 1e6),
    "force": ("driving force", "N", 1.0),
    "supply_pressure": ("supply pressure", "bar", 1e-5),
    "oil_temperature": ("oil temperature", "K", 1.0),
}
"""Name of a signal in a sentence, display unit and its factor."""


# --- running candidates ------------------------------------------------------------------------

_FORCE_LAW, _POSITION_LAW, _ALONG = 0, 1, 2
"""Source of the valve command: the law that follows a force, the one that follows a position, or a record."""

_LAWS = {"fasmc": (_FORCE_LAW, FORCE), "pid": (_POSITION_LAW, POSITION)}
"""Each law of the catalogue with the column of a record that follows its reference."""


class _Control(NamedTuple):
    """Observer and both laws, with their states.

    Attributes:
        friction: friction parameters of the observer.
        compensation: the observer's parameters.
        observed: its state.
        model: the laws' model of the rig.
        force_tuning: parameters of the law that follows a force.
        force_memory: its state.
        position_tuning: parameters of the law that follows a position.
        position_memory: its state.
        status: status of the law after its last step.
    """

    friction: Any
    compensation: rig_model.Parameters
    observed: ObserverState
    model: Model
    force_tuning: fasmc.Parameters
    force_memory: Array
    position_tuning: pid.Parameters
    position_memory: Array
    status: Array


class _Rows(NamedTuple):
    """External inputs, one row per cycle.

    Attributes:
        reference: shape (n, 3).
        load: disturbance, shape (n, 4).
        record: readings and command to run along, shape (n, readings + 1); not read under a law.
        pull: fraction of the distance by which the position is drawn to the recorded one in a cycle.
    """

    reference: Array
    load: Array
    record: Array
    pull: float


class _Bench(NamedTuple):
    """The compiled bench."""

    run: Callable[..., int]


def build(plant: Any, force_law: Any, position_law: Any, observer: Any) -> _Bench:
    """Build a bench from compiled modules: a plant under either law or along a record."""
    sense, cycle = plant.sense, plant.cycle
    force_step, position_step, update = force_law.step, position_law.step, observer.update

    @kernel
    def run(source: int, constants: Constants, state: State, control: _Control, rows: _Rows, out: Array) -> int:
        saturated, noise = 0, np.zeros(state.measured.size)
        measured, estimate, status = state.measured, control.observed.estimate, control.status
        last = measured.size
        for k in range(out.shape[0]):
            sense(k, constants, state, noise)
            if source == _FORCE_LAW:
                update(measured[VELOCITY], constants.period, control.friction, control.compensation, control.observed)
                tuning, memory = control.force_tuning, control.force_memory
                u = force_step(measured, rows.reference[k], estimate, tuning, control.model, memory, status)
            elif source == _POSITION_LAW:
                held, kept = control.position_tuning, control.position_memory
                u = position_step(measured, rows.reference[k], estimate, held, control.model, kept, status)
            else:
                u = rows.record[k, last]
                state.y[X] += rows.pull * (rows.record[k, POSITION] - measured[POSITION])
            saturated += abs(u) >= control.model.spool_limit
            out[k, :last] = measured
            out[k, last] = u
            cycle(k, constants, state, u, rows.load[k])
            state.inputs[TEMPERATURE] += constants.warming * constants.period
        return saturated

    return _Bench(run)


class _Run(NamedTuple):
    """Readings in the rig's order and the command, shape (n, readings + 1); fraction of the time at the valve's limit."""

    record: Array
    saturated: float


class _Experiment:
    """One experiment, ready to run on any candidate's rig."""

    def __init__(self, mapping: Mapping[str, Any], nominal: Rig) -> None:
        """Check the spec and sample the inputs that do not depend on the plant."""
        self.spec = spec_from_mapping({**mapping, "rig": rig_to_mapping(nominal)}, "catalogue", Path())
        spec = self.spec
        self.period = spec.settings.control_period
        self.reference = sampled(spec.reference, self.period).rows(0, spec.cycles)
        kind = DISTURBANCES.load(spec.disturbance.name)
        signal = sampled(spec.disturbance.signal, self.period)
        source = kind.build(spec.disturbance.parameters, signal, nominal, self.period)
        self.load: Array = source.rows(0, spec.cycles)

    def closed_loop(self, rig: Rig) -> _Run:
        """Run it with a rig as the plant."""
        return self._run(rig, _LAWS[self.spec.controller.name][0], np.zeros((1, len(rig.sensed) + 1)))

    def along(self, rig: Rig, given: Array) -> Array:
        """Simulate a rig's model along a record and return its readings and the command, shape (n, readings + 1)."""
        return self._run(rig, _ALONG, given).record

    def _run(self, rig: Rig, source: int, given: Array) -> _Run:
        plant = plant_of(self.spec._replace(rig=rig.quiet()))
        design, chosen = self.spec.controller_rig, self.spec.controller
        force_tuning = chosen.parameters if chosen.name == "fasmc" else tuned_for(fasmc.Parameters, design)
        position_tuning = chosen.parameters if chosen.name == "pid" else tuned_for(pid.Parameters, design)
        control = _Control(
            friction=design.friction,
            compensation=rig_model.Parameters(),
            observed=rig_model.state(design.friction_law, design.friction),
            model=model_of(design, self.period),
            force_tuning=force_tuning,
            force_memory=memory_on(fasmc, design.cylinder.law, force_tuning),
            position_tuning=position_tuning,
            position_memory=memory_on(pid, design.cylinder.law, position_tuning),
            status=np.zeros(STATUS_SIZE),
        )
        rows = _Rows(self.reference, self.load, given, self.period / MEMORY)
        record = np.empty((self.spec.cycles, len(rig.sensed) + 1))
        bench = _bench(plant, design)
        saturated = bench(source, plant.constants, plant.state, control, rows, record)
        return _Run(record, saturated / self.spec.cycles)


def _bench(plant: Simulated, believed: Rig) -> Callable[..., int]:
    """Return the compiled bench of a plant and the controller's rig; it calls kernels compiled before."""
    cylinder, valve = believed.cylinder.model, believed.valve.model
    modules = {
        "plant": plant_kernel(plant.parts),
        "force_law": controller_kernel("fasmc", cylinder, valve),
        "position_law": controller_kernel("pid", cylinder, valve),
        "observer": observer_kernel(ANY_MODEL, believed.friction_model),
    }
    bench: Callable[..., int] = compiled(build, {"run": "source, constants, state, control, rows, out"}, modules).run
    return bench


MAX_SATURATED = 0.05
"""Largest fraction of the time at the valve's limit in a proposed experiment."""

MAX_TRACKING_ERROR = 0.3
"""Largest rms error of a proposed experiment's loop, as a fraction of the reference's magnitude."""


def _unfit(run: _Run, experiment: _Experiment, rig: Rig) -> str:
    """Return the reason why an experiment cannot be proposed, given its run; empty if it can."""
    record, limits = run.record, rig.limits
    if not np.all(np.isfinite(record)):
        return "its loop does not stay finite"
    low, high = limits.position
    if record[:, POSITION].min() < low or record[:, POSITION].max() > high:
        return f"it moves from {record[:, POSITION].min():.3g} to {record[:, POSITION].max():.3g} m, beyond the stroke"
    for column, limit, unit in (
        (VELOCITY, limits.velocity, "m/s"),
        (FORCE, limits.force, "N"),
        (LOAD_PRESSURE, limits.load_pressure, "Pa"),
    ):
        largest = float(np.max(np.abs(record[:, column])))
        if largest > limit:
            return f"its {SENSED[column]} reaches {largest:.3g} {unit}, beyond the limit of {limit:.3g} {unit}"
    if run.saturated > MAX_SATURATED:
        return f"its valve is at the limit {100.0 * run.saturated:.0f} % of the time"
    followed = record[:, _LAWS[experiment.spec.controller.name][1]]
    wanted = experiment.reference[:, 0]
    settled = np.arange(len(record)) * experiment.period >= SETTLING
    size = max(float(np.std(wanted)), 0.02 * float(np.max(np.abs(followed - np.mean(followed)))), 1e-6)
    error = float(np.std((followed - wanted)[settled]))
    if np.ptp(wanted) > 0.0 and error > MAX_TRACKING_ERROR * size:
        return f"its loop does not follow the reference (rms {error:.3g} of {size:.3g})"
    return ""


# --- comparing them ----------------------------------------------------------------------------


class Pair(NamedTuple):
    """Two candidates and their expected separation by an experiment.

    Attributes:
        one: a candidate's name.
        other: the other's.
        sigma: expected separation: the part of the other's record that one cannot explain, in units of the noise floor.
    """

    one: str
    other: str
    sigma: float


class NextExperiment(NamedTuple):
    """The proposed experiment.

    Attributes:
        name: its name in :data:`CATALOGUE`.
        purpose: short description.
        why: one sentence on the pair that is hardest to separate: signal, time and size of the difference.
        separation: expected separation of each pair, the smallest first.
        spec: spec for ``ehls experiment``, without the rig file.
    """

    name: str
    purpose: str
    why: str
    separation: tuple[Pair, ...]
    spec: dict[str, Any]


class Considered(NamedTuple):
    """One experiment of the catalogue and its rating.

    Attributes:
        name: its name.
        sigma: separation of its worst pair; an upper bound if ``note`` says so, None if it is unsuitable.
        note: reason if it is unsuitable, or that the bound was below another's separation; otherwise empty.
    """

    name: str
    sigma: float | None
    note: str = ""


class Proposal(NamedTuple):
    """Result of the search.

    Attributes:
        experiment: the proposed experiment; None if none separates the candidates.
        reason: reason if there is none; otherwise empty.
        considered: every experiment of the catalogue, the best first.
    """

    experiment: NextExperiment | None
    reason: str
    considered: tuple[Considered, ...]


class _Rated(NamedTuple):
    """An experiment simulated on all candidates, with their records and the samples where the comparisons start."""

    name: str
    mapping: dict[str, Any]
    experiment: _Experiment
    records: dict[str, Array]
    starts: dict[str, int]
    bounds: dict[tuple[str, str], Difference]


def next_experiment(
    candidates: Mapping[str, Rig],
    *,
    nominal: Rig | None = None,
    signals: Sequence[str] | None = None,
    noise: Mapping[str, float] | None = None,
    parameter_std: float = 0.1,
    duration_limit: float = 20.0,
    progress: Callable[[int, int], None] | None = None,
) -> Proposal:
    """Propose the experiment that best separates candidate causes.

    Args:
        candidates: the extended rig of each open cause, by its name.
        nominal: rig with which the controller is designed; None: the first candidate's rig without effects.
        signals: signals to be recorded, names of :data:`~ehls_ros.physics.rig.EVERY_SENSED`, beside the command; None: those of
            :data:`RECORDED` or :data:`RECORDED_IN_CHAMBERS`.
        noise: standard deviation of a reading by signal, in its unit; missing signals use noise and resolution of the
            candidates' rigs.
        parameter_std: standard deviation of the candidates' parameters by the data so far, as a fraction of the value or of
            its distance from neutral, whichever is smaller.
        duration_limit: longest experiment allowed [s].
        progress: called with the number of experiments done and the total number.

    Returns:
        The proposal, or the reason why there is none.

    Raises:
        BadInput: an unknown signal, a noise below 0, a limit or standard deviation that is not above 0.
    """
    chambers = any(rig.cylinder.law.CHAMBERS for rig in candidates.values())
    sensed = EVERY_SENSED if chambers else SENSED
    if signals is None:
        signals = RECORDED_IN_CHAMBERS if chambers else RECORDED
    _check(signals, noise or {}, sensed, {"duration_limit": duration_limit, "parameter_std": parameter_std})
    if len(candidates) < 2:
        return Proposal(None, f"{len(candidates)} candidate: there is nothing to separate", ())
    names = tuple(candidates)
    believed = candidates[names[0]]._replace(effects=()) if nominal is None else nominal
    columns = [sensed.index(signal) for signal in dict.fromkeys(signals)]
    rated: list[_Rated] = []
    considered: list[Considered] = []
    for index, name in enumerate(CATALOGUE):
        answer = _rate(name, candidates, believed, columns, noise or {}, duration_limit)
        if isinstance(answer, str):
            considered.append(Considered(name, None, answer))
        else:
            rated.append(answer)
        if progress is not None:
            progress(index + 1, len(CATALOGUE))
    rated.sort(key=lambda entry: -min(d.sigma for d in entry.bounds.values()))
    best: tuple[_Rated, dict[tuple[str, str], Difference]] | None = None
    most = 0.0
    for entry in rated:
        bound = min(d.sigma for d in entry.bounds.values())
        # Fitting the parameters only reduces the difference.
        if bound <= most:
            considered.append(Considered(entry.name, bound, "upper bound, before its parameters are fitted"))
            continue
        left = {pair: _fitted(entry, pair, candidates, columns, parameter_std) for pair in entry.bounds}
        worst = min(d.sigma for d in left.values())
        considered.append(Considered(entry.name, worst))
        if best is None or worst > most:
            best, most = (entry, left), worst
    considered.sort(key=lambda c: -math.inf if c.sigma is None else c.sigma, reverse=True)
    if best is None and rated:
        return Proposal(None, "the candidates do not differ in any experiment of the catalogue", tuple(considered))
    if best is None:
        first = considered[0]
        reason = f"no experiment of the catalogue can be done on this rig: of {first.name}, {first.note}"
        return Proposal(None, reason, tuple(considered))
    entry, left = best
    if most < MIN_SIGMA:
        reason = f"the best experiment, {entry.name}, separates the candidates by {most:.1f} sigma only"
        return Proposal(None, reason, tuple(considered))
    proposed = NextExperiment(
        entry.name, CATALOGUE[entry.name].purpose, _why(entry, left, columns), _pairs(names, left), entry.mapping
    )
    return Proposal(proposed, "", tuple(considered))


def _check(signals: Sequence[str], noise: Mapping[str, float], sensed: Sequence[str], positive: Mapping[str, float]) -> None:
    if not signals:
        raise BadInput("signals is empty", "next experiment", f"names of {', '.join(sensed)}")
    for signal in (*signals, *noise):
        if signal not in sensed:
            raise BadInput(f"signal {signal!r} is unknown", "next experiment", f"one of {', '.join(sensed)}")
    for signal, value in noise.items():
        if not 0.0 <= value < math.inf:
            raise BadInput(f"noise of {signal} is {value:g}", "next experiment", "a finite number of 0 or more")
    for name, value in positive.items():
        if not value > 0.0:
            raise BadInput(f"{name} is {value:g}", "next experiment", "a number above 0")


def _rate(
    name: str,
    candidates: Mapping[str, Rig],
    nominal: Rig,
    columns: Sequence[int],
    noise: Mapping[str, float],
    duration_limit: float,
) -> _Rated | str:
    """Simulate an experiment on every candidate and along the others' records, or return the reason why not."""
    try:
        mapping = catalogue_spec(name, nominal)
        experiment = _Experiment(mapping, nominal)
    except (BadInput, ArithmeticError, ValueError) as error:
        return f"it does not suit the rig ({error})"
    duration = experiment.spec.settings.duration
    if duration > duration_limit:
        return f"it takes {duration:g} s, more than {duration_limit:g} s"
    records = {}
    for candidate, rig in candidates.items():
        run = experiment.closed_loop(rig)
        unfit = _unfit(run, experiment, rig)
        if unfit:
            return f"with {candidate}, {unfit}"
        records[candidate] = run.record
    period = experiment.period
    scale = scale_of(records, candidates, columns, noise, period)
    yielding = reach(nominal.effective()).yielding
    starts = {candidate: start_of(record, period, yielding) for candidate, record in records.items()}
    bounds = {}
    for true, model in permutations(candidates, 2):
        given, start = records[true], starts[true]
        shifted = given.copy()
        shifted[:, -1] += math.hypot(MODEL_ERROR * np.max(np.abs(given[:, SPOOL])), NULL_ERROR * nominal.limits.spool)
        along, off = experiment.along(candidates[model], given), experiment.along(candidates[model], shifted)
        if not np.all(np.isfinite(along + off)):
            return f"the model of {model} does not stay finite along the record of {true}"
        floor = np.hypot(scale, block_means(off - along, columns, period, start))
        bounds[true, model] = Difference(block_means(along - given, columns, period, start) / floor, floor)
    return _Rated(name, mapping, experiment, records, starts, bounds)


def _fitted(
    entry: _Rated, pair: tuple[str, str], candidates: Mapping[str, Rig], columns: Sequence[int], parameter_std: float
) -> Difference:
    """Subtract the part of another's record explained by a candidate with parameters fitted to it and to the data so far."""
    true, model = pair
    record, base = entry.records[true], entry.bounds[pair]
    stepped = [
        block_means(entry.experiment.along(rig, record) - record, columns, entry.experiment.period, entry.starts[true])
        for rig in stepped_rigs(candidates, model)
    ]
    return unexplained(base, [blocks / base.scale for blocks in stepped], parameter_std)


def _pairs(names: Sequence[str], left: Mapping[tuple[str, str], Difference]) -> tuple[Pair, ...]:
    pairs = [
        Pair(one, other, min(left[one, other].sigma, left[other, one].sigma))
        for index, one in enumerate(names)
        for other in names[index + 1 :]
    ]
    return tuple(sorted(pairs, key=lambda pair: pair.sigma))


def _why(entry: _Rated, left: Mapping[tuple[str, str], Difference], columns: Sequence[int]) -> str:
    """Name signal, moment and motion in which the worst pair differs most."""
    (true, model), difference = min(left.items(), key=lambda item: item[1].sigma)
    block, place = np.unravel_index(int(np.argmax(np.abs(difference.blocks))), difference.blocks.shape)
    label, unit, factor = NAMES[EVERY_SENSED[columns[int(place)]]]
    amount = abs(float(difference.blocks[block, place]))
    size = amount * float(difference.scale[block, place]) * factor
    period, length = entry.experiment.period, max(round(BLOCK / entry.experiment.period), 1)
    first = entry.starts[true] + int(block) * length
    part = entry.records[true][first : first + length]
    velocity, force = float(np.mean(part[:, VELOCITY])), float(np.mean(part[:, FORCE]))
    moving = f"the piston moves at {1e3 * velocity:.3g} mm/s" if abs(velocity) > 1e-4 else "the piston rests"
    loads = entry.experiment.load[:, LOAD]
    load = f", loaded with {loads[first] / 1e3:.2g} kN" if abs(loads[first]) > 0.01 * np.max(np.abs(loads)) else ""
    return (
        f"{model} fitted to a record of {true} deviates most in the {label}, by {size:.3g} {unit} ({amount:.0f} sigma) "
        f"at {(first + length // 2) * period:.1f} s, where {moving} under a driving force of {force / 1e3:.3g} kN{load}"
    )
