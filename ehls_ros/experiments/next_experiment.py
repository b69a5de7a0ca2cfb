"""The experiment that tells apart the causes a diagnosis left open.

Every experiment of :data:`~ehls_ros.experiments.catalogue.CATALOGUE` is simulated with each candidate's rig as the
plant, under the same controller, which knows the nominal rig. What is compared is not these closed loops: feedback
drives any two rigs apart in what it does not control and together in what it does, and a loop that sticks a moment
longer makes a large difference of nothing. Compared is how well one candidate's model **explains the record** of
another: it is run along that record with the same valve commands and the same disturbance, its position drawn to the
recorded one with the time constant :data:`MEMORY`. Position is the one state that nothing holds, as valve and cylinder
integrate; the others follow by the model's own forces. So it is a prediction over a window that moves along: an error
of the force balance shows in the pressure, one of the flow in the position (as the way gone wrong within the memory),
one of the valve in the spool.

Means over :data:`BLOCK`, in which a millisecond earlier or later makes no difference, are divided by what sensors and the
best model leave open: noise and resolution; :data:`MODEL_ERROR` of the signal's size; and what a valve's null that is
off by :data:`NULL_ERROR` would do just then, which is much where the piston sticks and a trickle builds up pressure.
The start is left out until friction has forgotten where it began, for nobody knows that of a real rig. From the rest,
what the candidate could explain by another value of its own parameters is taken off (least squares, linear around the
given values, which the data so far hold with a standard deviation), for all data will be fitted anew: the criterion of
T-optimal design (Atkinson, Fedorov, Biometrika 62, 1975). What remains, root of the sum of squares, is the separation
in sigma. Of a pair's two directions
the smaller counts, as nobody knows which one is true, and of all pairs the smallest: an experiment is as good as the
pair it tells apart worst. An experiment in which a candidate's loop leaves the rig's limits or does not follow its
reference is not proposed.

A cause that acts only through the displacement of a position servo (``coupling_stiffness``) is not excited: the loads
of the catalogue are forces.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.composition import controller_kernel, observer_kernel
from ehls_ros.control.controllers import fasmc, pid
from ehls_ros.control.controllers.base import STATUS_SIZE, model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import FORCE as LOAD
from ehls_ros.control.observers import ANY_MODEL, rig_model
from ehls_ros.errors import BadInput
from ehls_ros.experiments.catalogue import CATALOGUE, catalogue_spec, reach
from ehls_ros.experiments.loop import sampled, simulator_of
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.physics.composition import kernel_module, plant_source
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import SENSED, EffectUse, Rig, rig_to_mapping
from ehls_ros.physics.sensors import FORCE, LOAD_PRESSURE, POSITION, SPOOL, VELOCITY

MEMORY = 0.05
"""Time within which a model's position is drawn to the recorded one [s]."""

BLOCK = 0.025
"""Time over which readings are averaged before they are compared [s]; a few periods of oil and mass."""

SETTLING, WORN_IN = 0.5, 6.0
"""What is left out at the start: a time [s], and until the piston has gone this many times the way friction yields in."""

MODEL_ERROR = 1e-3
"""Part of a signal's size by which the best model of a rig is wrong; the floor of perfect sensors."""

NULL_ERROR = 2e-4
"""Part of the spool's limit by which the valve's null is not known."""

LEAST_SIGMA = 5.0
"""Separation below which causes are said not to be told apart."""

STEP = 0.05
"""Part of a parameter's value, or of its way from neutral, by which it is moved to see what it can explain."""

RECORDED = ("position", "load_pressure", "spool_position", "force")
"""What is recorded where nothing is said; the names of a rig file's sensors."""

NAMES = {
    "position": (f"position {1e3 * MEMORY:.0f} ms ahead", "mm", 1e3),
    "velocity": ("velocity", "mm/s", 1e3),
    "load_pressure": ("load pressure", "bar", 1e-5),
    "spool_position": ("spool displacement", "µm", 1e6),
    "force": ("driving force", "N", 1.0),
    "supply_pressure": ("supply pressure", "bar", 1e-5),
    "oil_temperature": ("oil temperature", "K", 1.0),
}
"""How a signal is called in a sentence, with a unit for it and its factor."""


# --- running candidates ------------------------------------------------------------------------

_FORCE_LAW, _POSITION_LAW, _ALONG = 0, 1, 2
"""What commands the valve: the law that follows a force, the one that follows a position, or a record."""

_LAWS = {"fasmc": (_FORCE_LAW, FORCE), "pid": (_POSITION_LAW, POSITION)}
"""Each law of the catalogue with the column of a record that follows its reference."""

_BENCH = '''"""A plant under either law, or along a record; generated."""
from numba import njit
from {plant} import advance, hold, sense
from {force_law} import step as force_law
from {position_law} import step as position_law
from {observer} import update
from ehls_ros.physics import plant as model, sensors


@njit(cache=True, error_model="numpy")
def bench(
    source, period, y, mode, plant, friction, inputs, effects, step, steps, warming, work, sensor_state, noise, truth, measured,
    reference, load, design_friction, compensation, observer_state, force_tuning, position_tuning, design,
    force_memory, position_memory, status, given, pull, record,
):
    saturated = 0
    last = measured.size
    for k in range(record.shape[0]):
        t = k * period
        sense(k, t, y, plant, inputs, effects, sensor_state, noise, truth, measured)
        if source == 0:
            update(measured[sensors.VELOCITY], period, design_friction, compensation, observer_state)
            u = force_law(measured, reference[k], observer_state.estimate, force_tuning, design, force_memory, status)
        elif source == 1:
            u = position_law(measured, reference[k], observer_state.estimate, position_tuning, design, position_memory, status)
        else:
            u = given[k, last]
            y[model.X] += pull * (given[k, sensors.POSITION] - measured[sensors.POSITION])
        saturated += abs(u) >= design.spool_limit
        record[k, :last] = measured
        record[k, last] = u
        hold(inputs, t, u, load[k, 0], load[k, 1], load[k, 2], load[k, 3])
        advance(t, y, mode, plant, friction, inputs, effects, step, steps, work)
        inputs[model.TEMPERATURE] += warming * period
    return saturated
'''


class _Run(NamedTuple):
    """Readings in the order of ``SENSED`` and the command, shape (n, 8); and the part of the time at the valve's limit."""

    record: Array
    saturated: float


class _Experiment:
    """One spec, ready to be run on any candidate's rig."""

    def __init__(self, mapping: Mapping[str, Any], nominal: Rig) -> None:
        """Check the spec and sample what does not depend on the plant."""
        self.spec = spec_from_mapping({**mapping, "rig": rig_to_mapping(nominal)}, "catalogue", Path())
        spec = self.spec
        self.period = spec.settings.control_period
        self.reference = sampled(spec.reference, self.period).rows(0, spec.cycles)
        kind = DISTURBANCES.load(spec.disturbance.name)
        signal = sampled(spec.disturbance.signal, self.period)
        source: Any = kind.build(spec.disturbance.parameters, signal, nominal, self.period)
        self.load: Array = source.rows(0, spec.cycles)

    def closed_loop(self, rig: Rig) -> _Run:
        """Run it with a rig as the plant."""
        return self._run(rig, _LAWS[self.spec.controller.name][0], np.zeros((1, len(SENSED) + 1)))

    def along(self, rig: Rig, given: Array) -> Array:
        """Run a rig's model along a record and return what its sensors would have read, shape (n, 8)."""
        return self._run(rig, _ALONG, given).record

    def _run(self, rig: Rig, source: int, given: Array) -> _Run:
        simulator = simulator_of(self.spec._replace(rig=rig.quiet()))
        design, chosen = self.spec.controller_rig, self.spec.controller
        force_tuning = chosen.parameters if chosen.name == "fasmc" else fasmc.Parameters()
        position_tuning = chosen.parameters if chosen.name == "pid" else pid.Parameters()
        record = np.empty((self.spec.cycles, len(SENSED) + 1))
        saturated = _bench(rig, design.friction_model)(
            source,
            self.period,
            simulator.y,
            simulator.mode,
            simulator.rig.plant,
            simulator.rig.friction,
            simulator.inputs,
            simulator.effects,
            simulator.step,
            simulator.steps,
            simulator.warming,
            simulator.work,
            simulator.sensors,
            np.zeros(len(SENSED)),
            simulator.truth,
            simulator.measured,
            self.reference,
            self.load,
            design.friction,
            rig_model.Parameters(),
            rig_model.state(design.friction_law, design.friction),
            force_tuning,
            position_tuning,
            model_of(design, self.period),
            fasmc.memory(force_tuning),
            pid.memory(position_tuning),
            np.zeros(STATUS_SIZE),
            given,
            self.period / MEMORY,
            record,
        )
        return _Run(record, saturated / self.spec.cycles)


def _bench(rig: Rig, believed: str) -> Callable[..., int]:
    """Return the compiled bench of a rig's effects and the controller's friction model; it calls kernels compiled before."""
    modules = {
        "plant": kernel_module(plant_source(rig)),
        "force_law": controller_kernel("fasmc"),
        "position_law": controller_kernel("pid"),
        "observer": observer_kernel(ANY_MODEL, believed),
    }
    source = _BENCH.format(**{part: module.__name__ for part, module in modules.items()})
    bench: Callable[..., int] = kernel_module(source).bench
    return bench


MOST_SATURATED = 0.05
"""Part of the time the valve may be at its limit in an experiment that is proposed."""

LOOSEST = 0.3
"""Error, as a part of the reference's size, within which a loop that is proposed follows; rms."""


def _unfit(run: _Run, experiment: _Experiment, rig: Rig) -> str:
    """Return why an experiment cannot be proposed, given its run; empty if it can."""
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
    if run.saturated > MOST_SATURATED:
        return f"its valve is at the limit {100.0 * run.saturated:.0f} % of the time"
    followed = record[:, _LAWS[experiment.spec.controller.name][1]]
    wanted = experiment.reference[:, 0]
    settled = np.arange(len(record)) * experiment.period >= SETTLING
    size = max(float(np.std(wanted)), 0.02 * float(np.max(np.abs(followed - np.mean(followed)))), 1e-6)
    error = float(np.std((followed - wanted)[settled]))
    if np.ptp(wanted) > 0.0 and error > LOOSEST * size:
        return f"its loop does not follow the reference (rms {error:.3g} of {size:.3g})"
    return ""


# --- comparing them ----------------------------------------------------------------------------


class Pair(NamedTuple):
    """Two candidates and how far apart an experiment is expected to put them.

    Attributes:
        one: a candidate's name.
        other: the other's.
        sigma: expected separation: what of one's record the other cannot explain, in units of the noise floor.
    """

    one: str
    other: str
    sigma: float


class NextExperiment(NamedTuple):
    """The experiment proposed.

    Attributes:
        name: its name in :data:`CATALOGUE`.
        purpose: what it is, in a few words.
        why: one sentence: which signal tells the two causes that are hardest to tell apart, when, and how large the
            difference is.
        separation: expected separation of each pair, the smallest first.
        spec: what ``ehls experiment`` runs, once ``rig`` names a rig file.
    """

    name: str
    purpose: str
    why: str
    separation: tuple[Pair, ...]
    spec: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Return the mapping that ``diagnosis.json`` holds."""
        return {**self._asdict(), "separation": [pair._asdict() for pair in self.separation]}


class Considered(NamedTuple):
    """One experiment of the catalogue as it was judged.

    Attributes:
        name: its name.
        sigma: separation of the pair it tells apart worst; an upper bound where ``note`` says so, None where it is unfit.
        note: why it is unfit, or that the bound was already below another's separation; else empty.
    """

    name: str
    sigma: float | None
    note: str = ""


class Proposal(NamedTuple):
    """What came of the search.

    Attributes:
        experiment: the experiment to do next; None if none tells the candidates apart.
        reason: why there is none; else empty.
        considered: every experiment of the catalogue, the best first.
    """

    experiment: NextExperiment | None
    reason: str
    considered: tuple[Considered, ...]


class _Difference(NamedTuple):
    """What of one candidate's record another cannot explain.

    Attributes:
        blocks: in units of the noise floor, shape (blocks, signals).
        scale: the noise floor of each block and signal in its unit, shape (blocks, signals).
        bent: how far its parameters were moved off the data so far, in their standard deviations.
    """

    blocks: Array
    scale: Array
    bent: float = 0.0

    @property
    def sigma(self) -> float:
        """Separation."""
        return math.hypot(float(np.linalg.norm(self.blocks)), self.bent)


class _Judged(NamedTuple):
    """An experiment that was run on all candidates, with each one's record and where its comparison starts."""

    name: str
    mapping: dict[str, Any]
    experiment: _Experiment
    records: dict[str, Array]
    starts: dict[str, int]
    bounds: dict[tuple[str, str], _Difference]


def next_experiment(
    candidates: Mapping[str, Rig],
    *,
    nominal: Rig | None = None,
    signals: Sequence[str] = RECORDED,
    noise: Mapping[str, float] | None = None,
    parameter_std: float = 0.1,
    duration_limit: float = 20.0,
    progress: Callable[[int, int], None] | None = None,
) -> Proposal:
    """Propose the experiment that separates candidate causes best.

    Args:
        candidates: the extended rig of each cause that is still open, by its name.
        nominal: what the controller knows; the first candidate's rig without effects where nothing is said.
        signals: what will be recorded, names of :data:`~ehls_ros.physics.rig.SENSED`; the command always is.
        noise: standard deviation of a reading by signal, in its unit; where a signal is left out, what the
            candidates' rigs say of its noise and resolution.
        parameter_std: how well the data so far tell the candidates' parameters: standard deviation as a part of the value,
            or of its way from neutral where that is smaller.
        duration_limit: longest experiment wanted [s].
        progress: called with the experiments done and the experiments in all.

    Returns:
        The proposal, or the reason why there is none.

    Raises:
        BadInput: an unknown signal, a noise below 0, a limit or standard deviation that is not above 0.
    """
    _check(signals, noise or {}, {"duration_limit": duration_limit, "parameter_std": parameter_std})
    if len(candidates) < 2:
        return Proposal(None, f"{len(candidates)} candidate: there is nothing to tell apart", ())
    names = tuple(candidates)
    believed = candidates[names[0]]._replace(effects=()) if nominal is None else nominal
    columns = [SENSED.index(signal) for signal in dict.fromkeys(signals)]
    judged: list[_Judged] = []
    considered: list[Considered] = []
    for index, name in enumerate(CATALOGUE):
        answer = _judge(name, candidates, believed, columns, noise or {}, duration_limit)
        if isinstance(answer, str):
            considered.append(Considered(name, None, answer))
        else:
            judged.append(answer)
        if progress is not None:
            progress(index + 1, len(CATALOGUE))
    judged.sort(key=lambda entry: -min(d.sigma for d in entry.bounds.values()))
    best: tuple[_Judged, dict[tuple[str, str], _Difference]] | None = None
    most = 0.0
    for entry in judged:
        bound = min(d.sigma for d in entry.bounds.values())
        # What parameters explain only takes away.
        if bound <= most:
            considered.append(Considered(entry.name, bound, "at most this, before its parameters are fitted"))
            continue
        left = {pair: _unexplained(entry, pair, candidates, columns, parameter_std) for pair in entry.bounds}
        worst = min(d.sigma for d in left.values())
        considered.append(Considered(entry.name, worst))
        if best is None or worst > most:
            best, most = (entry, left), worst
    considered.sort(key=lambda c: -math.inf if c.sigma is None else c.sigma, reverse=True)
    if best is None and judged:
        return Proposal(None, "in no experiment of the catalogue do the candidates differ", tuple(considered))
    if best is None:
        first = considered[0]
        reason = f"no experiment of the catalogue can be done on this rig: of {first.name}, {first.note}"
        return Proposal(None, reason, tuple(considered))
    entry, left = best
    if most < LEAST_SIGMA:
        reason = f"the best experiment, {entry.name}, separates the candidates by {most:.1f} sigma only"
        return Proposal(None, reason, tuple(considered))
    proposed = NextExperiment(
        entry.name, CATALOGUE[entry.name].purpose, _why(entry, left, columns), _pairs(names, left), entry.mapping
    )
    return Proposal(proposed, "", tuple(considered))


def _check(signals: Sequence[str], noise: Mapping[str, float], positive: Mapping[str, float]) -> None:
    if not signals:
        raise BadInput("signals is empty", "next experiment", f"names of {', '.join(SENSED)}")
    for signal in (*signals, *noise):
        if signal not in SENSED:
            raise BadInput(f"signal {signal!r} is unknown", "next experiment", f"one of {', '.join(SENSED)}")
    for signal, value in noise.items():
        if not 0.0 <= value < math.inf:
            raise BadInput(f"noise of {signal} is {value:g}", "next experiment", "a finite number of 0 or more")
    for name, value in positive.items():
        if not value > 0.0:
            raise BadInput(f"{name} is {value:g}", "next experiment", "a number above 0")


def _judge(
    name: str,
    candidates: Mapping[str, Rig],
    nominal: Rig,
    columns: Sequence[int],
    noise: Mapping[str, float],
    duration_limit: float,
) -> _Judged | str:
    """Run an experiment on every candidate and every candidate along the others' records, or say why not."""
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
    scale = _scale(records, candidates, columns, noise, period)
    yielding = reach(nominal).yielding
    starts = {candidate: _start(record, period, yielding) for candidate, record in records.items()}
    bounds = {}
    for true, model in permutations(candidates, 2):
        given, start = records[true], starts[true]
        shifted = given.copy()
        shifted[:, -1] += math.hypot(MODEL_ERROR * np.max(np.abs(given[:, SPOOL])), NULL_ERROR * nominal.limits.spool)
        along, off = experiment.along(candidates[model], given), experiment.along(candidates[model], shifted)
        if not np.all(np.isfinite(along + off)):
            return f"the model of {model} does not stay finite along the record of {true}"
        floor = np.hypot(scale, _blocks(off - along, columns, period, start))
        bounds[true, model] = _Difference(_blocks(along - given, columns, period, start) / floor, floor)
    return _Judged(name, mapping, experiment, records, starts, bounds)


def _start(record: Array, period: float, yielding: float) -> int:
    """Return the sample at which friction has forgotten where it began; the last where it never does."""
    way = np.cumsum(np.abs(record[:, VELOCITY])) * period
    return max(round(SETTLING / period), int(np.searchsorted(way, WORN_IN * yielding)))


def _scale(
    records: Mapping[str, Array],
    candidates: Mapping[str, Rig],
    columns: Sequence[int],
    noise: Mapping[str, float],
    period: float,
) -> Array:
    """Return what is left open of a block's mean of each signal, in its unit."""
    scale = np.empty(len(columns))
    for place, column in enumerate(columns):
        signal = SENSED[column]
        scatter = [noise[signal]] if signal in noise else []
        for rig in candidates.values() if signal not in noise else ():
            sensor = rig.sensors.get(signal)
            if sensor is not None:
                scatter.append(math.hypot(sensor.noise_std, sensor.resolution / math.sqrt(12.0)))
        largest = max(_size(record, column, period) for record in records.values())
        scale[place] = math.hypot(max(scatter, default=0.0), MODEL_ERROR * largest) or 1.0
    return scale


def _size(record: Array, column: int, period: float) -> float:
    """Return the size of what a model has to predict of a signal: of the position, the way gone within the memory."""
    if column != POSITION:
        return float(np.max(np.abs(record[:, column])))
    ahead = max(round(MEMORY / period), 1)
    return float(np.max(np.abs(record[ahead:, column] - record[:-ahead, column]), initial=0.0))


def _blocks(values: Array, columns: Sequence[int], period: float, start: int) -> Array:
    """Return means over blocks from a sample on, shape (blocks, signals)."""
    length = max(round(BLOCK / period), 1)
    settled = values[start:, list(columns)]
    count = len(settled) // length
    means: Array = settled[: count * length].reshape(count, length, len(columns)).mean(axis=1)
    return means


def _unexplained(
    entry: _Judged, pair: tuple[str, str], candidates: Mapping[str, Rig], columns: Sequence[int], parameter_std: float
) -> _Difference:
    """Take off what a candidate explains of another's record with its parameters fitted to this and the data so far."""
    true, model = pair
    period, record, start = entry.experiment.period, entry.records[true], entry.starts[true]
    base, scale, _ = entry.bounds[pair]
    slopes = []
    for rig in _moved(candidates, model):
        along = entry.experiment.along(rig, record)
        slope = _blocks(along - record, columns, period, start) / scale - base
        if np.all(np.isfinite(slope)):
            slopes.append(slope.ravel())
    if not slopes:
        return entry.bounds[pair]
    directions = np.column_stack(slopes)
    held = np.eye(len(slopes)) * STEP / parameter_std
    wanted = np.concatenate([-base.ravel(), np.zeros(len(slopes))])
    steps, *_ = np.linalg.lstsq(np.vstack([directions, held]), wanted)
    left = base + (directions @ steps).reshape(base.shape)
    return _Difference(left, scale, float(np.linalg.norm(held @ steps)))


def _moved(candidates: Mapping[str, Rig], name: str) -> list[Rig]:
    """Return a candidate's rig with each parameter that its cause has set a little nearer to its neutral value."""
    rig = candidates[name]
    rigs = []
    for index, use in enumerate(rig.effects):
        if all(use in other.effects for other in candidates.values()):
            continue
        neutral = EFFECTS.load(use.name).Parameters()
        for field, value in use.parameters._asdict().items():
            way = getattr(neutral, field) - value
            if way == 0.0:
                continue
            # A neutral value may stand for infinity, as the place of an end stop does.
            size = min(abs(way), abs(value)) or abs(way)
            nearer = use.parameters._replace(**{field: value + STEP * math.copysign(size, way)})
            effects = (*rig.effects[:index], EffectUse(use.name, nearer), *rig.effects[index + 1 :])
            rigs.append(rig._replace(effects=effects))
    return rigs


def _pairs(names: Sequence[str], left: Mapping[tuple[str, str], _Difference]) -> tuple[Pair, ...]:
    pairs = [
        Pair(one, other, min(left[one, other].sigma, left[other, one].sigma))
        for index, one in enumerate(names)
        for other in names[index + 1 :]
    ]
    return tuple(sorted(pairs, key=lambda pair: pair.sigma))


def _why(entry: _Judged, left: Mapping[tuple[str, str], _Difference], columns: Sequence[int]) -> str:
    """Name signal, moment and regime in which the pair that is told apart worst differs most."""
    (true, model), difference = min(left.items(), key=lambda item: item[1].sigma)
    block, place = np.unravel_index(int(np.argmax(np.abs(difference.blocks))), difference.blocks.shape)
    label, unit, factor = NAMES[SENSED[columns[int(place)]]]
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
        f"{model} fitted to what {true} would give is wrong most in the {label}, by {size:.3g} {unit} ({amount:.0f} sigma) "
        f"at {(first + length // 2) * period:.1f} s, where {moving} under a driving force of {force / 1e3:.3g} kN{load}"
    )
