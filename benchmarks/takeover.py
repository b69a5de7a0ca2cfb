"""Take-over to position control when specimen or load cell fails, and unloading, on the simulated plant behind the gate.

    python -m benchmarks.takeover [--sizes 0.1 1 10] [--phases 8] [--drawn 8]

A specimen, a spring, is loaded at 50 Hz through the gate by a law that knows the rig. Then its stiffness goes to zero within
5 ms or at once, or its load cell reads zero, nothing or a constant, at several phases of the load cycle. The fault is visible
from the first of two consecutive snapshots in which the specimen lacks more than ``stiffness_drop`` of the change of its force
and a tenth of the force limit; or in which the load cell's reading is not a number or contradicts the load pressure by
``force_mismatch``.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import parser_of, print_heading, print_row
from benchmarks.own_rigs import drawn
from benchmarks.scaled_rigs import similar
from ehls_ros.arrays import Array, in_python
from ehls_ros.control.rig_scale import compression, largest_speed, tuned_for
from ehls_ros.errors import WorkFailed
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import load_rig
from ehls_ros.hardware.gate_bounds import bounds_of, within
from ehls_ros.hardware.gate_parameters import POSITION, Parameters
from ehls_ros.hardware.safety_gate import UNLOADING, Gate
from ehls_ros.physics import sensors
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import SENSED, Rig, rig_from_mapping
from ehls_ros.physics.simulator import Simulator

PERIOD = 1e-3
FREQUENCY = 50.0
"""Frequency of the load; half the valve's bandwidth where that is lower, on rigs from data sheets [Hz]."""

LEARNING = 3.0
"""Time of loading before the fault [s]."""

CELL = ("on_sensor_not_finite", "on_sensor_jump", "on_sensor_frozen", "on_sensor_mismatch", "on_sensor_range")
"""Reactions to a broken load cell."""

GUARDED: Mapping[str, Any] = {"stiffness_drop": 0.5, "mismatch_time": 0.002, **dict.fromkeys(CELL, POSITION)}
"""Gate of a passive specimen, which holds the piston when the load cell breaks, too."""

FAULTS = ("lost in 5 ms", "lost at once", "cell reads 0", "cell reads NaN", "cell reads a constant")


class Loading(NamedTuple):
    """A rig and its specimen.

    Attributes:
        rig: the rig.
        stiffness: of the specimen [N/m].
        mean: of the force [N].
        amplitude: of the force [N].
        frequency: of the force [Hz].
    """

    rig: Rig
    stiffness: float
    mean: float
    amplitude: float
    frequency: float = FREQUENCY


def scaled(size: float, stiffness: float = 2e7) -> Loading:
    """Return the paper's rig with sensors, ``size`` times as large, and a specimen as stiff on the paper's [N/m]."""
    rig = similar(load_rig(config_folder() / "rig_paper_measured.yaml"), size)
    return Loading(rig, size * stiffness, size * 2e3, size * 6e3)


def own(number: int, seed: int) -> Loading:
    """Return a rig from the data sheets of :mod:`benchmarks.own_rigs` with its delay, and a specimen that it can load."""
    content = drawn(number, seed).content
    content["effects"] = [use for use in content["effects"] if use["name"] == "command_delay" and use["delay"] > 0.0]
    rig = rig_from_mapping(content, "drawn rig")
    frequency = min(FREQUENCY, 0.5 * rig.plant.valve_bandwidth / (2.0 * math.pi))
    inertia = rig.plant.moving_mass * (2.0 * math.pi * frequency) ** 2
    return Loading(rig, 3.0 * inertia, 0.1 * rig.limits.force, 0.2 * rig.limits.force, frequency)


class Cycle(NamedTuple):
    """A cycle.

    Attributes:
        truth: true signals in the order of ``SENSED``.
        cell: reading of the load cell [N].
        sound: remaining fraction of the specimen's stiffness.
        output: of the gate [m].
        state: of the gate.
    """

    truth: Array
    cell: float
    sound: float
    output: float
    state: str


class LoadedSpecimen:
    """A rig that loads a specimen through the gate.

    Attributes:
        rig: with the sound specimen.
        gate: in front of the valve.
        cycles: run so far.
        sound: remaining fraction of the specimen's stiffness.
        cell: turns the force into the load cell's reading [N].
        frequency: of the load [Hz].
    """

    def __init__(self, loading: Loading, seed: int = 0, *, held: bool = False, **chosen: Any) -> None:
        """Start at rest and enable the gate.

        Args:
            loading: rig, specimen and force.
            seed: of the sensors' noise.
            held: whether the largest force is held, from the beginning, instead of load cycles.
            **chosen: parameters of the gate.
        """
        self._loading = loading
        plant = loading.rig.plant._replace(spring_stiffness=loading.stiffness)
        self.rig = loading.rig._replace(plant=plant)
        self._held = loading.mean + loading.amplitude if held else None
        load = (self._held or 0.0) - plant.moving_mass * plant.gravity
        self._simulator = Simulator(self.rig, PERIOD, position=load / plant.spring_stiffness)
        self._simulator.y[PL] = (self._held or 0.0) / plant.piston_area
        self._constants = self._simulator.constants
        usual = within(tuned_for(Parameters, self.rig, {"enable_time": 0.1}), bounds_of(self.rig, PERIOD))
        self.gate = Gate(self.rig, PERIOD, usual._replace(**chosen))
        self.gate.begin()
        self._noise = np.random.default_rng(seed)
        self.cycles = list[Cycle]()
        self.sound, self.frequency = 1.0, loading.frequency
        self.cell: Callable[[float], float] = lambda force: force
        self._speed = plant.valve_gain * in_python(largest_speed)(plant, 1.0)
        self._compression = in_python(compression)(plant)
        self.turn()
        refusal = self.gate.enable()
        if refusal is not None:
            raise WorkFailed(f"the gate does not open: {refusal}")

    def _command(self, measured: float) -> float:
        """Return the command that the plant's linear model needs, corrected in proportion to the force's error [m]."""
        plant, known = self.rig.plant, math.isfinite(measured)
        oil = 1.0 / (self._compression * plant.piston_area * self._speed)
        if self._held is not None:
            # The leakage under this force, besides.
            leakage = plant.leakage_coefficient * self._held / (plant.piston_area**2 * self._speed)
            return leakage + (10.0 * oil * (self._held - measured) if known else 0.0)
        w, t = 2.0 * math.pi * self.frequency, len(self.cycles) * PERIOD
        # The load sets in within a second.
        amplitude = min(t, 1.0) * self._loading.amplitude
        force = min(t, 1.0) * self._loading.mean + amplitude * math.sin(w * t)
        rate, curvature = amplitude * w * math.cos(w * t), -amplitude * w * w * math.sin(w * t)
        moving = plant.spring_stiffness - plant.moving_mass * w * w
        per_rate = oil + 1.0 / (moving * self._speed)
        return per_rate * (rate + curvature / plant.valve_bandwidth + (5.0 * (force - measured) if known else 0.0))

    def turn(self) -> None:
        """Run one cycle."""
        simulator, number, limit = self._simulator, len(self.cycles), self.rig.limits.spool
        readings = simulator.measure(self._noise.standard_normal(len(SENSED))).tolist()
        truth = simulator.truth.copy()
        readings[sensors.FORCE] = self.cell(readings[sensors.FORCE])
        self.gate.sense(number, readings)
        self.gate.take(number, min(max(self._command(readings[sensors.FORCE]), -limit), limit), "law")
        output = self.gate.step(number * PERIOD)
        self.cycles.append(Cycle(truth, readings[sensors.FORCE], self.sound, output, self.gate.state))
        left = self._constants.plant._replace(spring_stiffness=self.sound * self.rig.plant.spring_stiffness)
        simulator.constants = self._constants._replace(plant=left)
        simulator.advance(output, 0.0, 0.0, 0.0, 0.0)

    def run(self, duration: float) -> None:
        """Run for a time [s]."""
        for _ in range(round(duration / PERIOD)):
            self.turn()

    def signal(self, index: int) -> Array:
        """Return a true signal of all cycles."""
        return np.array([cycle.truth[index] for cycle in self.cycles])

    def fail(self, kind: str) -> None:
        """Let the specimen or its load cell fail, as one of :data:`FAULTS`."""
        stuck = self.cycles[-1].cell
        match kind:
            case "lost in 5 ms":
                for part in range(1, 6):
                    self.sound = 1.0 - part / 5.0
                    self.turn()
            case "lost at once":
                self.sound = 0.0
            case "cell reads 0":
                self.cell = lambda force: 0.0
            case "cell reads NaN":
                self.cell = lambda force: math.nan
            case _:
                self.cell = lambda force: stuck


class Outcome(NamedTuple):
    """Result of a fault.

    Attributes:
        causes: detectors that tripped.
        state: of the gate at the end.
        cycles: snapshots that showed the fault until the gate took over, the first one included.
        step: largest step of the command per cycle since then, over that of a ramp from the largest opening [1].
        speed: largest speed of the piston since the fault, over the limit [1].
        force: largest force since the fault, over the limit [1].
        travel: from the position at the take-over to that at the end [m].
        wander: largest distance from the position at the end, from half a second after the take-over on [m].
    """

    causes: tuple[str, ...]
    state: str
    cycles: int
    step: float
    speed: float
    force: float
    travel: float
    wander: float


def failed(loading: Loading, kind: str, phase: float, seed: int = 0, **chosen: Any) -> Outcome:
    """Return the outcome of a fault at a phase of the load cycle, between 0 and 1."""
    run = LoadedSpecimen(loading, seed, **{**GUARDED, **chosen})
    run.run(LEARNING + phase / loading.frequency)
    if run.gate.causes:
        raise WorkFailed(f"the sound specimen tripped the gate: {run.gate.causes[0]}")
    begin = len(run.cycles)
    run.fail(kind)
    run.run(2.0)
    position, velocity, force = (run.signal(index) for index in (sensors.POSITION, sensors.VELOCITY, sensors.FORCE))
    middle = float(np.mean(position[begin - round(1.0 / PERIOD) : begin]))
    shown = [_shows(run, cycle, kind, middle) for cycle in run.cycles[begin:]]
    visible = begin + next(k for k in range(len(shown)) if all(shown[k : k + 2]))
    taken = next((k for k in range(begin, len(run.cycles)) if run.cycles[k].state != "active"), None)
    if taken is None:
        return Outcome((), run.gate.state, len(run.cycles) - visible, *[math.nan] * 5)
    output = np.array([cycle.output for cycle in run.cycles[taken - 1 :]])
    limits = run.rig.limits
    return Outcome(
        tuple(cause.detector for cause in run.gate.causes),
        run.gate.state,
        taken - visible + 1,
        float(np.max(np.abs(np.diff(output)))) * run.gate.parameters.ramp_time / (limits.spool * PERIOD),
        float(np.max(np.abs(velocity[begin:]))) / limits.velocity,
        float(np.max(np.abs(force[begin:]))) / limits.force,
        float(abs(position[-1] - position[taken])),
        float(np.max(np.abs(position[taken + round(0.5 / PERIOD) :] - position[-1]))),
    )


def _shows(run: LoadedSpecimen, cycle: Cycle, kind: str, middle: float) -> bool:
    """Return whether a snapshot shows the fault; ``middle``: mean position of the load cycles [m]."""
    plant, position = run.rig.plant, float(cycle.truth[sensors.POSITION])
    if kind.startswith("cell"):
        contradiction = cycle.cell - plant.piston_area * float(cycle.truth[sensors.LOAD_PRESSURE])
        return bool(not abs(contradiction) <= run.gate.parameters.force_mismatch)
    change = plant.spring_stiffness * (position - middle)
    lack = math.copysign(1.0, change) * (1.0 - cycle.sound) * plant.spring_stiffness * position
    return bool(lack > max(run.gate.parameters.stiffness_drop * abs(change), 0.1 * run.rig.limits.force))


class Unloading(NamedTuple):
    """Result of a request to unload.

    Attributes:
        state: of the gate at the end.
        peak: largest force since the request, over that before it, of the last load cycle if there are any [1].
        duration: time until the force stays below 2 % of its limit [s].
        closed: time until the valve is at null [s].
        speed: largest speed of the piston since then, over the limit [1].
    """

    state: str
    peak: float
    duration: float
    closed: float
    speed: float


def unloaded(loading: Loading, *, held: bool, phase: float = 0.0, **chosen: Any) -> Unloading:
    """Return the outcome of a request to unload a specimen, held at the largest force or loaded at 50 Hz.

    Args:
        loading: rig, specimen and force.
        held: whether the force is held.
        phase: of the load cycle, between 0 and 1.
        **chosen: parameters of the gate.
    """
    run = LoadedSpecimen(loading, held=held, **chosen)
    run.run(1.5 + phase / loading.frequency)
    begin = len(run.cycles)
    refusal = run.gate.unload()
    if refusal is not None:
        raise WorkFailed(f"the gate does not unload: {refusal}")
    while run.gate.state == UNLOADING or run.gate.output:
        run.turn()
    end = len(run.cycles)
    run.run(1.0)
    force, velocity, limits = np.abs(run.signal(sensors.FORCE)), run.signal(sensors.VELOCITY), run.rig.limits
    high = np.flatnonzero(force[begin:] > 0.02 * limits.force)
    before = force[begin - (1 if held else round(1.0 / loading.frequency / PERIOD)) : begin]
    return Unloading(
        run.gate.state,
        float(np.max(force[begin:]) / np.max(before)),
        float((high[-1] + 1) * PERIOD) if high.size else 0.0,
        (end - begin) * PERIOD,
        float(np.max(np.abs(velocity[begin:]))) / limits.velocity,
    )


def _print_faults(name: str, outcomes: Iterable[Outcome]) -> None:
    found = list(outcomes)
    held = sum(outcome.state == "position control" for outcome in found)
    worst = (max(getattr(outcome, field) for outcome in found) for field in ("cycles", "step", "speed", "force"))
    away = (f"{1e3 * max(getattr(outcome, field) for outcome in found):.3f}" for field in ("travel", "wander"))
    print_row(name, f"{held} of {len(found)}", *(f"{value:.3g}" for value in worst), *away)


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--sizes", type=float, nargs="+", default=[0.1, 1.0, 10.0], help="of the rigs over the paper's")
    parser.add_argument("--phases", type=int, default=8, help="phases of the load cycle (%(default)s)")
    parser.add_argument("--drawn", type=int, default=8, help="rigs from data sheets (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of those rigs (%(default)s)")
    options = parser.parse_args()
    phases = [number / options.phases for number in range(options.phases)]
    print_heading("worst of a fault", "held", "cycles", "step/ramp", "speed/limit", "force/limit", "travel, mm", "wander, mm")
    for size in options.sizes:
        for kind in FAULTS:
            _print_faults(f"{size:g} ×, {kind}", (failed(scaled(size), kind, phase) for phase in phases))
    for number in range(options.drawn):
        sound = LoadedSpecimen(own(number, options.seed), **GUARDED)
        sound.run(LEARNING)
        if sound.gate.causes:
            print_row(f"drawn {number}", f"its valve does not follow this load: {sound.gate.causes[0]}", *[""] * 6)
            continue
        for kind in FAULTS:
            _print_faults(f"drawn {number}, {kind}", (failed(own(number, options.seed), kind, phase) for phase in phases))
    print_heading("unloading", "peak/start", "below 2 %, s", "closed, s", "speed/limit")
    for size in options.sizes:
        for stiffness in (1e9, 2e7, 1e6, 4e4):
            found = unloaded(scaled(size, stiffness), held=True)
            print_row(f"{size:g} ×, held, {stiffness:g} N/m", *(f"{value:.4g}" for value in found[1:]))
        cyclic = [unloaded(scaled(size), held=False, phase=phase) for phase in phases]
        print_row(
            f"{size:g} ×, at 50 Hz, worst phase", *(f"{max(values):.4g}" for values in list(zip(*cyclic, strict=True))[1:])
        )


if __name__ == "__main__":
    main()
