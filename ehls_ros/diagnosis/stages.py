"""Stage-by-stage comparison of the model with a recording.

Each stage takes its inputs from the recording and its output is compared with the recording, so that an error of one stage
does not spread to the others:

* ``valve``: the spool (4) simulated from the recorded command against the recorded spool;
* ``flow``: the volume balance (1), (2) from recorded spool, pressure and position, or that of each chamber; and the supply
  pressure;
* ``force_balance``: the balance (3) with the friction model run along the recorded motion;
* ``sensors``: two sensors of one quantity: load cell against load pressure, velocity against position.

A missing spool signal is replaced by the simulated spool, a missing load pressure by that of the load cell. Of the pressures
of two chambers and the driving force, two give the third. The friction and the hooks of effects need velocity, which is taken
from a local fit of the position.
"""

import math
from collections.abc import Callable, Container, Mapping
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.record import (
    COMMAND,
    FORCE,
    LOAD,
    POSITION,
    PRESSURE,
    SERVO_POSITION,
    SERVO_VELOCITY,
    SPOOL,
    SUPPLY,
    TEMPERATURE,
    VELOCITY,
    Record,
)
from ehls_ros.diagnosis.resolution import command_seen, friction_known, presliding_travel
from ehls_ros.diagnosis.windows import Window, integral, local_row, local_slope, smooth_window
from ehls_ros.duals import linear, value_of, values_of
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import MEMORY_STEP
from ehls_ros.physics.imposed_motion import PARTS, coefficients_read, effects_in, run_part
from ehls_ros.physics.imposed_motion.base import ModelRun, Motion
from ehls_ros.physics.imposed_motion.chambers import Chambers
from ehls_ros.physics.imposed_motion.friction import FrictionInputs
from ehls_ros.physics.imposed_motion.load import Piston
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import EffectiveRig, EffectUse, Rig, unknown_keys
from ehls_ros.physics.simulator import OIL_TEMPERATURE, earlier_commands
from ehls_ros.samples import Mask
from ehls_ros.trajectory import PRESSURE_A, PRESSURE_B

FRICTION_STEP = 1e-3
"""Longest integration step of a friction model [s]."""

MISREAD, MISREAD_PASSES = ("position", "load_pressure", "force"), 6
"""Sensors to whose readings effects add errors, and most passes in which these are found from the readings."""

MISREAD_LEFT = 1e-5
"""Change of these errors in a pass, as a fraction of the largest, below which they are found."""

FASTEST_SHARE = 0.999
"""Quantile of the speed for which a stiff friction model is integrated."""

RELAXED = 1.5
"""Relaxation times of a friction model per integration step, at most."""

FORGOTTEN, LONGEST_MEMORY = 0.05, 0.2
"""Effect of an unknown friction force at the beginning that no longer counts, as a fraction of the Coulomb friction; and the
most of a stretch that is left out for it after the first sliding.

Origin: an error of 5 % of a few 100 N that goes on decaying is less than the noise. It decays in 1.2 s of sliding on the
paper's rig, too long for a recording of a few seconds.
"""

MAX_STEPS = 40
"""Most integration steps of a friction model per sample."""

MIN_STEP = 1e-4
"""Shortest integration step of a separate load; a model that diverges at that step is no rig [s]."""

GUIDED_STEP = 0.6
"""Integration step of a separate load relative to the guide's time constant of the lighter mass, at most."""

FINER = 4
"""Samples of the simulated spool per sample of the recording where its course between them counts; an even number."""

LENGTHENED = 20
"""Lengths of local fits differ by a tenth at most where they are longer than this."""

RATE = 3, 1
"""Degree and derivative of the local fit that gives a signal's rate."""

FITS = {POSITION: RATE, VELOCITY: (2, 0)}
"""Degree and derivative of the local fit that gives the velocity, by the signal it comes from."""

KEPT_RUNS = 3
"""Runs of each part of the model that are kept for reuse."""

Stage = Literal["force_balance", "flow", "valve", "sensors"]
STAGES: tuple[Stage, ...] = ("force_balance", "flow", "valve", "sensors")

Channel = Literal["spool", "volume", "volume_a", "volume_b", "supply", "force", "cell", "velocity"]


class ChannelKind(NamedTuple):
    """Kind of a residual channel.

    Attributes:
        stage: the stage it belongs to.
        unit: unit of the residual.
        needed: signals from which it is formed, those whose noise affects the residual most first.
        sensor: name in the rig file of the sensor of the measured quantity; empty for a balance.
        averaged: whether the windows are those of spool and sensors, not those of the balances.
    """

    stage: Stage
    unit: str
    needed: tuple[str, ...]
    sensor: str = ""
    averaged: bool = False


KINDS: Mapping[Channel, ChannelKind] = {
    "spool": ChannelKind("valve", "m", (SPOOL, COMMAND), "spool_position", averaged=True),
    "volume": ChannelKind("flow", "m³/s", (POSITION, VELOCITY, SPOOL, PRESSURE, FORCE)),
    "volume_a": ChannelKind("flow", "m³/s", (POSITION, VELOCITY, SPOOL, PRESSURE_A, PRESSURE_B, PRESSURE, FORCE)),
    "volume_b": ChannelKind("flow", "m³/s", (POSITION, VELOCITY, SPOOL, PRESSURE_B, PRESSURE_A, PRESSURE, FORCE)),
    "supply": ChannelKind("flow", "Pa", (SUPPLY,), "supply_pressure", averaged=True),
    "force": ChannelKind("force_balance", "N", (POSITION, VELOCITY, PRESSURE, FORCE, LOAD)),
    "cell": ChannelKind("sensors", "N", (PRESSURE, FORCE), "force", averaged=True),
    "velocity": ChannelKind("sensors", "m/s", (POSITION, VELOCITY), "velocity"),
}
"""Residual channels."""

BY_CHAMBER: tuple[Channel, ...] = ("volume_a", "volume_b")
"""Volume balances of both chambers, A and B."""

VOLUMES: tuple[Channel, ...] = ("volume", *BY_CHAMBER)
"""Volume balances: of the load flow, or of both chambers."""

CHANNELS: Mapping[Channel, Stage] = {channel: kind.stage for channel, kind in KINDS.items()}
"""Stage of each channel."""

COMMAND_UNSEEN = "needs a slower command or faster samples: at {rate} Hz, commands between two samples were missed"
TURNS_UNSEEN = (
    "needs slower motion or faster samples: at {rate} Hz, the piston turns through its presliding between two samples"
)
NOT_IN_FILE = "needs {keys} in the rig file"
"""Reason why a stage is not judged although its signals were recorded."""

REQUIRED: frozenset[Channel] = frozenset({"force"})
"""Channels whose residual is required minus measured; in the others it is measured minus modelled."""

GUIDE = 2.0 * math.pi / rules.WINDOW
"""Rate at which a piston separated from the load is guided to its measured position [rad/s].

The balances resolve nothing faster. Setting the piston directly to its measured position would pass the position sensor's
noise, times the stiffness of a contact, on to the load; the pressure gives that force far more accurately.
"""

LOADS = frozenset({FORCE, PRESSURE, PRESSURE_A, PRESSURE_B})
"""Signals of which the load cell's residual is formed."""

SENSED = {
    "position": POSITION,
    "velocity": VELOCITY,
    "load_pressure": PRESSURE,
    "spool_position": SPOOL,
    "force": FORCE,
    "supply_pressure": SUPPLY,
    "oil_temperature": TEMPERATURE,
    "pressure_a": PRESSURE_A,
    "pressure_b": PRESSURE_B,
}
"""Recorded signals, by the sensors' names in the rig file."""


class Setup(NamedTuple):
    """Parts of the model that can be compared with a recording.

    Attributes:
        window: window of the balances.
        average: window over which spool and sensors are averaged.
        channels: the residuals that can be formed.
        velocity_measured: whether velocities come from the velocity sensor, if that is the quieter source.
        fit: number of samples of the local fit.
        presliding: travel over which static friction builds up in the given model [m].
        why_not: reason why a stage cannot be compared although its signals are there.
        valve: the rig whose valve gives the spool's course between samples; None without a command.
    """

    window: Window
    average: Window
    channels: tuple[Channel, ...]
    velocity_measured: bool
    fit: int
    presliding: float = 0.0
    why_not: Mapping[Stage, str] = {}
    valve: EffectiveRig | None = None

    def with_wider_fit(self) -> "Setup":
        """Return the setup with a wider local fit; the change of a result measures the error by the fit's rounding."""
        return self._replace(fit=self.fit + 2 * max(1, round(rules.WIDER_FIT * self.fit)))

    def window_of(self, channel: Channel) -> Window:
        """Return the windows of a channel."""
        return self.average if KINDS[channel].averaged else self.window


class Comparison:
    """One recording and the cached latest runs of the parts of the model along it."""

    def __init__(self, record: Record, setup: Setup) -> None:
        """Store the recording and its setup."""
        self.record = record
        self.setup = setup
        self._kept: dict[str, dict[Any, Any]] = {}

    def residuals(self, rig: Rig, channels: tuple[Channel, ...] | None = None) -> dict[Channel, Any]:
        """Compare a rig's model with the recording.

        Args:
            rig: the rig, with effects; its numbers may be duals, those of sensors only in the sensor channels.
            channels: the residuals to form; by default all that can be formed.

        Returns:
            Residual of each channel in its unit, one value a window; a dual if it depends on one.
        """
        effective = rig.effective()
        wanted = self.setup.channels if channels is None else channels
        residual: dict[Channel, Callable[[EffectiveRig], Any]] = {
            "spool": self._spool, "volume": self._volume, **{c: partial(self._volume_of, c) for c in BY_CHAMBER},
            "supply": self._supply, "force": self._force, "cell": self._cell, "velocity": self._velocity,
        }  # fmt: skip
        # A diverging model has no finite residual, and its fit is rejected.
        with np.errstate(over="ignore", invalid="ignore"):
            return {channel: residual[channel](effective) for channel in wanted}

    def measured(self, rig: Rig, channel: Channel) -> Array:
        """Return the measured quantity to which a channel's residual refers, in its unit, one value a window.

        Args:
            rig: the rig whose sensors the signals are corrected for.
            channel: for the force balance, the driving force; for the flow balance, the flow taken up by the cylinder.
        """
        effective, window = rig.effective(), self.setup.window_of(channel)
        if channel == "volume":
            return self._taken_up(effective)
        if channel in BY_CHAMBER:
            return self._taken_up_by(effective, channel)
        if channel == "force":
            return window.mean(effective.plant.piston_area * self.pressure(effective))
        return window.mean(self.corrected(effective, KINDS[channel].sensor))

    def relevant(self, rig: Rig) -> dict[Channel, Any]:
        """Return the dependencies of each channel's residual; equal dependencies imply equal residuals."""
        whole = rig.effective()
        plant, sensors = whole.plant, whole.sensors
        hooks = {part: effects_in(part, whole) and _read(part, whole) for part in PARTS}
        spool = _read("spool", whole)
        seen = spool if SPOOL not in self.record else None
        x, v = (sensors.get("position"), hooks["readings"]), sensors.get("velocity")
        cell = (sensors.get("force"), hooks["readings"])
        load = (sensors.get("load_pressure"), hooks["readings"]) if PRESSURE in self.record else cell
        p = (load, sensors.get("pressure_a"), sensors.get("pressure_b"), _areas(whole))
        sides = {channel: _of_side(whole, channel) for channel in BY_CHAMBER}
        # Where its sensor is missing, the supply pressure follows from the flow through all edges.
        supply = (sensors.get("supply_pressure"),) if SUPPLY in self.record else (_supply(whole), *sides.values())
        valve = (plant.supply_pressure, plant.oil_density, plant.discharge_coefficient, plant.valve_area_gradient)
        oil = (plant.total_volume, plant.piston_area)
        spool_sensor = sensors.get("spool_position")
        moved = (x, v, p, spool_sensor)
        return {
            "spool": (spool, spool_sensor, moved if hooks["spool"] else None),
            "volume": (_read("flow", whole), oil, seen, moved),
            **{c: (_read("chambers", whole), oil, seen, moved, used, supply) for c, used in sides.items()},
            "supply": (
                valve,
                hooks["flow"],
                hooks["chambers"],
                seen,
                moved,
                sensors.get("supply_pressure"),
                sides,
                _supply(whole),
            ),
            "force": (_beam(whole), whole.friction_model, whole.friction, hooks["friction"], hooks["force"], moved),
            "cell": (plant.piston_area, p, cell),
            "velocity": (x, v),
        }

    # --- residuals -----------------------------------------------------------------------------

    def _spool(self, rig: EffectiveRig) -> Any:
        average = self.setup.average
        return average.mean(self.corrected(rig, "spool_position")) - average.mean(self.simulated_spool(rig))

    def _volume(self, rig: EffectiveRig) -> Any:
        terms = self.flow_terms(rig)
        return self._taken_up(rig) - self.setup.window.mean(terms[:, 0] - terms[:, 1])  # (2)

    def _taken_up(self, rig: EffectiveRig) -> Any:
        """Return the flow taken up by the piston's motion and the oil's compression, one value a window [m^3/s]."""
        plant, motion = rig.plant, self._measured_motion(rig)
        yielding = plant.total_volume / (4.0 * self.flow_terms(rig)[:, 2])
        return plant.piston_area * self._swept(rig, motion) + self._compressed(yielding, self.pressure(rig))

    def _compressed(self, yielding: Any, pressure: Any) -> Any:
        """Return the flow that a compliance, one value a sample [m^3/Pa], takes up, one value a window [m^3/s]."""
        squeezed = 0.5 * (yielding[1:] + yielding[:-1]) * linear(np.diff, pressure)
        # A difference of neighbours would lack 2 % of the slope at 50 Hz and 1 kHz, and the window's derivative does not.
        return self.setup.window.rate(linear(lambda steps: np.concatenate([[0.0], np.cumsum(steps)]), squeezed))

    def _volume_of(self, channel: Channel, rig: EffectiveRig) -> Any:
        terms, index = self.chamber_terms(rig), BY_CHAMBER.index(channel)
        return self._taken_up_by(rig, channel) - self.setup.window.mean(terms[:, index] - terms[:, 2 + index])

    def _taken_up_by(self, rig: EffectiveRig, channel: Channel) -> Any:
        """Return the flow taken up by the piston's motion and the compression in a chamber, one value a window [m^3/s]."""
        p, motion, index = rig.cylinder.parameters, self._measured_motion(rig), BY_CHAMBER.index(channel)
        area, at_zero, hose = (
            (p.area_a, p.volume_a, p.hose_compliance_a),
            (-p.area_b, p.volume_b, p.hose_compliance_b),
        )[index]
        yielding = (at_zero + area * motion.position) / self.chamber_terms(rig)[:, 4 + index] + hose
        return area * self._swept(rig, motion) + self._compressed(yielding, self.chamber_pressures(rig)[index])

    def _swept(self, rig: EffectiveRig, motion: Motion) -> Any:
        if POSITION in self.record:
            return self.setup.window.rate(self.corrected(rig, "position"))
        return self.setup.window.mean(motion.velocity)

    def _supply(self, rig: EffectiveRig) -> Any:
        return self.setup.average.mean(self.corrected(rig, "supply_pressure") - self.supply_pressure(rig))

    def supply_pressure(self, rig: EffectiveRig) -> Any:
        """Return the supply pressure of the model along the recording, shape (n,) [Pa]."""
        return self.chamber_terms(rig)[:, 6] if rig.cylinder.law.CHAMBERS else self.flow_terms(rig)[:, 3]

    def _force(self, rig: EffectiveRig) -> Any:
        window, plant = self.setup.window, rig.plant
        motion = self._measured_motion(rig)
        if rig.piston_mass() > 0.0:
            return self._force_of_parted(rig, motion)
        given = self._driving(rig, motion) - self.friction(rig)[:, 0]
        if POSITION in self.record:
            x = self.corrected(rig, "position")
            inertia = plant.moving_mass * window.acceleration(x)
            return inertia + plant.viscous_damping * window.rate(x) - window.mean(given)  # (3)
        balance = plant.moving_mass * window.rate(motion.velocity) - window.mean(
            given - plant.viscous_damping * motion.velocity
        )
        # The initial position is unknown, and so is the spring force there.
        return balance - linear(np.mean, balance)

    def _force_of_parted(self, rig: EffectiveRig, motion: Motion) -> Any:
        """Return the summed balances of a separate load and piston, in which the force between them cancels."""
        window, plant = self.setup.window, rig.plant
        position, _, friction, others = self.load(rig).T
        acceleration = (
            window.acceleration(self.corrected(rig, "position")) if POSITION in self.record else window.rate(motion.velocity)
        )
        inertia = plant.moving_mass * window.acceleration(position) + rig.piston_mass() * acceleration
        balance = inertia - window.mean(others - friction)  # (3)
        return balance if POSITION in self.record else balance - linear(np.mean, balance)

    def _driving(self, rig: EffectiveRig, motion: Motion) -> Any:
        """Return the force on the mass without friction, damping and inertia [N]."""

        def compute() -> Any:
            plant = rig.plant
            pushed = plant.piston_area * self.pressure(rig) - plant.spring_stiffness * motion.position
            return pushed - plant.moving_mass * plant.gravity - motion.disturbance + self.extra_force(rig)[:, 0]

        return self._keep("driving", (_beam(rig), self.relevant_parts(rig, "force")), compute)

    def _cell(self, rig: EffectiveRig) -> Any:
        left = self.corrected(rig, "force") - rig.plant.piston_area * self.pressure(rig)
        used = LOADS & self.record.signals.keys()
        bandwidths = [value_of(sensor.bandwidth) for name, sensor in rig.sensors.items() if SENSED.get(name) in used]
        slowest = min((bandwidth for bandwidth in bandwidths if bandwidth > 0.0), default=0.0)
        return self.setup.average.mean(linear(lambda signal: self._slowed(signal, slowest), left) if slowest > 0.0 else left)

    def _slowed(self, values: Array, bandwidth: float) -> Array:
        """Return a signal behind the lag of a sensor, shape (n,): its noise, amplified by correction of the lag, is as before.

        Args:
            values: the signal, linear between its samples, shape (n,).
            bandwidth: of the sensor [rad/s].
        """
        a = math.exp(-bandwidth * self.record.period)
        mean = (1.0 - a) / (bandwidth * self.record.period)
        weights = (1.0 - mean, mean - a)

        def slow(part: Array) -> Array:
            before = [weights[1] * part[0] + a * part[0]]
            slowed, _ = scipy.signal.lfilter(weights, (1.0, -a), part, zi=before)
            return np.asarray(slowed, dtype=np.float64)

        return self.record.by_stretch(slow, values)

    def _velocity(self, rig: EffectiveRig) -> Any:
        window = self.setup.window
        return window.mean(self.corrected(rig, "velocity")) - window.rate(self.corrected(rig, "position"))

    # --- parts of the model --------------------------------------------------------------------

    def simulated_spool(self, rig: EffectiveRig) -> Any:
        """Return the spool displacement simulated from the recorded command, shape (n,) [m]."""
        key = self.relevant_parts(rig, "spool")
        return self._keep("spool", key, lambda: self._run("spool", rig, self._measured_motion(rig)))[:, 0]

    def flow_terms(self, rig: EffectiveRig) -> Any:
        """Return load flow, leakage [m^3/s], bulk modulus and supply pressure [Pa], shape (n, 4)."""
        key = (self.relevant_parts(rig, "flow"), None if SPOOL in self.record else self.relevant_parts(rig, "spool"))
        return self._keep("flow", key, lambda: self._run("flow", rig, self.motion(rig)))

    def chamber_terms(self, rig: EffectiveRig) -> Any:
        """Return the terms of the chambers' balances, shape (n, 7); columns as in :mod:`ehls_ros.physics.imposed_motion`."""
        seen = None if SPOOL in self.record else self.relevant_parts(rig, "spool")
        key = (self.relevant_parts(rig, "chambers"), rig.plant, rig.cylinder, rig.valve, seen)
        return self._keep("chambers", key, lambda: self._run_chambers(rig, self.motion(rig)))

    def _run_chambers(self, rig: EffectiveRig, motion: Motion) -> Any:
        a, b = (linear(np.ascontiguousarray, signal) for signal in self.chamber_pressures(rig))
        supply = linear(np.ascontiguousarray, self.corrected(rig, "supply_pressure"))
        inputs = Chambers(a, b, supply, SUPPLY in self.record, rig.cylinder.parameters, rig.valve.parameters)
        return run_part("chambers", rig, self._along("chambers", rig, motion, self._memory_steps("chambers", rig)), inputs)

    def flow(self, rig: Rig, channel: Channel) -> Any:
        """Return the flow from the valve in a volume balance, shape (n,) [m^3/s]."""
        effective = rig.effective()
        return (
            self.flow_terms(effective)[:, 0]
            if channel == "volume"
            else self.chamber_terms(effective)[:, BY_CHAMBER.index(channel)]
        )

    def extra_force(self, rig: EffectiveRig) -> Any:
        """Return the additional force of effects not in (3), shape (n, 1) [N]."""
        key = self.relevant_parts(rig, "force")
        return self._keep("force", key, lambda: self._run("force", rig, self._measured_motion(rig)))

    def friction(self, rig: EffectiveRig) -> Any:
        """Return the friction force along the recorded motion, shape (n, 1) [N]."""
        balance, key = self._balance(rig), (self.relevant_parts(rig, "friction"), rig.friction, rig.friction_model)
        # The other forces set the initial state of the elements, and the force a static model balances during stick.
        rigid = math.isinf(rig.friction_law.stiffness(values_of(rig.friction)))
        differentiated = not isinstance(balance, np.ndarray)
        others = (_beam(rig), self.relevant_parts(rig, "force")) if rigid or differentiated else balance.tobytes()
        return self._keep("friction", (key, self._moves(rig), others), lambda: self._run_friction(rig, balance))

    def friction_range(self, rig: EffectiveRig) -> Array:
        """Return the range of the friction force for all its values at the start of each stretch, shape (n,) [N]."""
        highest = np.full(int(np.count_nonzero(self.record.fresh)), rig.friction_level(0.0))
        above, below = (self._run_friction(rig, balance)[:, 0] for balance in (highest, -highest))
        apart: Array = np.abs(above - below)
        return apart

    def load(self, rig: EffectiveRig) -> Any:
        """Return position [m] and velocity [m/s] of a separate load, and its friction and all other forces [N]."""
        key = (self.relevant_parts(rig, "load"), rig.friction, rig.friction_model, rig.plant)
        return self._keep("load", key, lambda: self._run_load(rig, self._measured_motion(rig)))

    def relevant_parts(self, rig: EffectiveRig, part: str) -> Any:
        """Return the dependencies of a part's run."""
        return (*_read(part, rig), tuple(sorted(rig.sensors.items())), effects_in("readings", rig))

    def _along(self, part: str, rig: EffectiveRig, motion: Motion, steps: int) -> ModelRun:
        record, history = self.record, earlier_commands(rig, self.record.period, lasting=True) if part == "spool" else 0
        effects = PARTS[part].effects.parameters(rig.effects)
        return ModelRun(motion, record.fresh, record.period, steps, history, rig.plant, rig.friction, effects)

    def _memory_steps(self, part: str, rig: EffectiveRig) -> int:
        """Return the integration steps per sample required by the effects' states; 0 without such states."""
        longest = min((longest_step(use) for use in effects_in(part, rig)), default=math.inf)
        return math.ceil(self.record.period / longest) if math.isfinite(longest) else 0

    def _run(self, part: str, rig: EffectiveRig, motion: Motion) -> Any:
        return run_part(part, rig, self._along(part, rig, motion, self._memory_steps(part, rig)))

    def _finer(self, a: ModelRun, moved: bool) -> ModelRun:
        """Return a run with :data:`FINER` times the samples; the command is held, and the measured states are linear.

        Args:
            a: the run.
            moved: whether it depends on anything but the command.
        """
        samples = len(a.motion.time)
        instants = np.arange(FINER * (samples - 1) + 1)
        if moved:
            motion = Motion(*(np.interp(instants, FINER * np.arange(samples), value_of(signal)) for signal in a.motion))
        else:
            motion = Motion(*[np.zeros(len(instants))] * len(a.motion))
        fresh = np.zeros(len(instants), dtype=np.bool_)
        fresh[::FINER] = a.fresh
        command = np.ascontiguousarray(a.motion.command[instants // FINER])
        motion, steps = motion._replace(command=command), math.ceil(a.steps / FINER)
        return a._replace(motion=motion, fresh=fresh, period=a.period / FINER, steps=steps, history=FINER * a.history)

    def _run_friction(self, rig: EffectiveRig, balance: Any) -> Any:
        period, motion = self.record.period, self._measured_motion(rig)
        steps = max(1, self._memory_steps("friction", rig), math.ceil(period / FRICTION_STEP), self._stiff_steps(rig, motion))
        scale = value_of(getattr(rig.friction, "stribeck_velocity", math.inf))
        extra = linear(np.ascontiguousarray, self.extra_force(rig)[:, 0])
        inputs = FrictionInputs(extra, balance, scale)
        return run_part("friction", rig, self._along("friction", rig, motion, steps), inputs)

    def _run_load(self, rig: EffectiveRig, motion: Motion) -> Any:
        piston = rig.piston_mass()
        mass, moving = value_of(piston), value_of(rig.plant.moving_mass)
        longest = min(MEMORY_STEP, GUIDED_STEP * min(mass, moving) / (mass + moving) / (2.0 * GUIDE))
        longest = max(longest, MIN_STEP)
        steps = max(math.ceil(self.record.period / longest), self._stiff_steps(rig, motion))
        effects, joint = PARTS["load"].effects, tuple(use for use in rig.effects if use.piston_share > 0.0)
        others = rig._replace(effects=tuple(use for use in rig.effects if use not in joint))
        side = Piston(effects.parameters(joint), effects.piston_state(joint[0].name), piston, GUIDE)
        return run_part("load", rig, self._along("load", others, motion, steps), side)

    def _stiff_steps(self, rig: EffectiveRig, motion: Motion) -> int:
        """Return the integration steps per sample required by the friction model's relaxation."""
        speed: float = self._keep("speed", self._moves(rig), lambda: float(np.quantile(np.abs(motion.velocity), FASTEST_SHARE)))
        fastest = rig.friction_law.relaxation_rate(values_of(rig.friction), speed)
        return min(MAX_STEPS, max(1, math.ceil(fastest * self.record.period / RELAXED)))

    def _balance(self, rig: EffectiveRig) -> Any:
        """Return the friction that balances the other forces at the start of each stretch, from smoothed motion [N]."""
        motion = self._measured_motion(rig)
        acceleration = self._keep("acceleration", self._moves(rig), lambda: self._rate(motion.velocity))
        plant, fresh = rig.plant, self.record.fresh
        damping = plant.viscous_damping + rig.friction.viscous_coefficient
        inertia = plant.moving_mass * acceleration[fresh] + damping * motion.velocity[fresh]
        return self._driving(rig, motion)[fresh] - inertia

    # --- the recording's signals, corrected for the rig's sensors -------------------------------

    def corrected(self, rig: EffectiveRig, sensor: str) -> Any:
        """Return a signal corrected for its sensor's gain, bias, lag and delay, shape (n,)."""
        description = rig.sensors.get(sensor, Sensor())
        raw = self.record.values(SENSED[sensor])
        gain, bias, bandwidth, delay = description.gain, description.bias, description.bandwidth, description.delay
        misread = effects_in("readings", rig) if sensor in MISREAD else ()
        if gain == 1.0 and bias == 0.0 and bandwidth == 0.0 and delay == 0.0 and not misread:
            return raw

        def compute() -> Any:
            values = (raw - bias) / gain
            if bandwidth > 0.0:
                values = values + linear(lambda signal: self.local_fit(signal, 1), values) / bandwidth
            if delay > 0.0:
                # A high-order spline: linear interpolation would average noise, and any delay would seem to help.
                ahead = -delay / self.record.period
                values = linear(lambda signal: scipy.ndimage.shift(signal, ahead, order=5, mode="nearest"), values)
            return values - self.misread(rig)[:, MISREAD.index(sensor)] if misread else values

        plant = rig.plant if misread else None
        return self._keep(f"corrected {sensor}", (gain, bias, bandwidth, delay, misread, plant), compute)

    def misread(self, rig: EffectiveRig) -> Array:
        """Return the errors that effects add to the readings of :data:`MISREAD`, shape (n, 3).

        They depend on the true signals, which are the readings less the errors. Where the pressure sensor remembers, as with a
        hysteresis, its reading does not tell the pressure, and that of the load cell is taken if there is one.
        """

        def compute() -> Array:
            used = effects_in("readings", rig)
            others = rig._replace(effects=tuple(use for use in rig.effects if use not in used))
            along = self._along("readings", rig, self._measured_motion(others), self._memory_steps("readings", rig))
            along = along._replace(motion=Motion(*map(value_of, along.motion)))
            other_sensor = FORCE in self.record and any(_remembers(use, "pressure_reading") for use in used)
            area = value_of(rig.plant.piston_area)
            by_cell = value_of(self.corrected(others, "force")) / area if other_sensor else np.empty(0)
            errors = np.zeros((len(self.record.time), len(MISREAD)))
            for _ in range(MISREAD_PASSES):
                position, pressure, force = np.ascontiguousarray(errors.T)
                motion = along.motion._replace(
                    position=along.motion.position - position,
                    pressure=by_cell - force / area if other_sensor else along.motion.pressure - pressure,
                )
                before, errors = errors, value_of(run_part("readings", rig, along._replace(motion=motion)))
                if np.max(np.abs(errors - before)) <= MISREAD_LEFT * np.max(np.abs(errors)):
                    break
            return errors

        errors: Array = self._keep("misread", (self._moves(rig), rig.plant), compute)
        return errors

    def pressure(self, rig: EffectiveRig) -> Any:
        """Return the load pressure, from the load cell if there is no pressure sensor, shape (n,) [Pa]."""
        if PRESSURE_A in self.record and PRESSURE_B in self.record:
            area_a, area_b = _areas(rig)
            driving = area_a * self.corrected(rig, "pressure_a") - area_b * self.corrected(rig, "pressure_b")
            return driving / rig.plant.piston_area
        if PRESSURE in self.record:
            return self.corrected(rig, "load_pressure")
        return self.corrected(rig, "force") / rig.plant.piston_area

    def chamber_pressures(self, rig: EffectiveRig) -> tuple[Any, Any]:
        """Return the pressures of both chambers, one of them from the driving force if it was not recorded [Pa]."""
        area_a, area_b = _areas(rig)
        a, b = (self.corrected(rig, name) if SENSED[name] in self.record else None for name in ("pressure_a", "pressure_b"))
        if a is None:
            a = (rig.plant.piston_area * self.pressure(rig) + area_b * b) / area_a
        return a, (area_a * a - rig.plant.piston_area * self.pressure(rig)) / area_b if b is None else b

    def local_fit(self, values: Array, derivative: int) -> Array:
        """Return a signal or its derivative from a local cubic fit, shape (n,)."""
        return _filtered(self.record, values, local_row(self.setup.fit, 3 if derivative else 2, derivative, self.record.period))

    def _rate(self, values: Array) -> Array:
        """Return the rate of a signal without noise, shape (n,)."""
        return self.record.by_stretch(lambda part: np.gradient(part, self.record.period), values)

    def motion(self, rig: EffectiveRig) -> Motion:
        """Return the motion along which the parts are run; a missing spool signal is replaced by the simulated one."""
        motion = self._measured_motion(rig)
        spool = motion.spool if SPOOL in self.record else self.simulated_spool(rig)
        return motion._replace(spool=spool + self._between_samples())

    def _between_samples(self) -> Array:
        """Return the correction of each sample of the spool by which their mean becomes that of its course, shape (n,) [m].

        The command steps at samples, where the slope of a spool of first order jumps. The mean of its samples then lags behind
        that of the spool, for a valve of 100 Hz at 1 kHz by 50 µs, which would pass for compression and leakage of the oil.
        """
        valve, samples = self.setup.valve, len(self.record.time)
        if valve is None:
            return np.zeros(samples)

        def compute() -> Array:
            steps = self._memory_steps("spool", valve)
            along = self._along("spool", valve, self._measured_motion(valve), steps)
            fine = run_part("spool", valve, self._finer(along, moved=bool(effects_in("spool", valve))))[:, 0]
            begins, middles, ends = fine[:-2:2], fine[1:-1:2], fine[2::2]
            # Simpson's rule, as the spool is smooth between two steps of the command.
            means = ((begins + 4.0 * middles + ends) / 6.0).reshape(samples - 1, FINER // 2).mean(axis=1)
            slopes = np.diff(fine[::FINER])
            beyond = means - 0.5 * (fine[:-1:FINER] + fine[FINER::FINER])
            # Samples of a smooth signal have its mean under a smooth window: here, both terms cancel.
            bends = np.diff(slopes, prepend=slopes[:1], append=slopes[-1:])
            return 0.5 * (np.append(beyond, 0.0) + np.append(0.0, beyond)) + bends / 12.0

        correction: Array = self._keep("between", None, compute)
        return correction

    def _measured_motion(self, rig: EffectiveRig) -> Motion:
        motion: Motion = self._keep("motion", self._moves(rig), lambda: self._make_motion(rig))
        return motion

    def _moves(self, rig: EffectiveRig) -> Any:
        """Return the dependencies of the recorded motion."""
        areas = (rig.plant.piston_area, _areas(rig))
        return tuple((name, rig.sensors.get(name)) for name in SENSED), areas, effects_in("readings", rig)

    def _make_motion(self, rig: EffectiveRig) -> Motion:
        record = self.record
        if POSITION in record:
            position = self.corrected(rig, "position")
            if self.setup.velocity_measured:
                velocity = self._kept_to(position, self.local_fit(self.corrected(rig, "velocity"), 0))
            else:
                velocity = self.local_fit(position, 1)
            position = self.local_fit(position, 0)
        else:
            velocity = self.corrected(rig, "velocity")
            position = integral(velocity, record.period)
            velocity = self.local_fit(velocity, 0)
        pressure = self.pressure(rig) if PRESSURE in record or FORCE in record else np.zeros(len(record.time))
        temperature = (
            self.corrected(rig, "oil_temperature") if TEMPERATURE in record else np.full(len(record.time), OIL_TEMPERATURE)
        )
        return Motion(
            time=record.time,
            position=np.ascontiguousarray(position),
            velocity=np.ascontiguousarray(velocity),
            pressure=np.ascontiguousarray(pressure),
            spool=np.ascontiguousarray(self.corrected(rig, "spool_position")),
            command=record.values(COMMAND),
            disturbance=record.values(LOAD),
            servo_position=record.values(SERVO_POSITION),
            servo_velocity=record.values(SERVO_VELOCITY),
            temperature=np.ascontiguousarray(temperature),
        )

    def _kept_to(self, position: Array, velocity: Array) -> Array:
        """Return the measured velocity, corrected for the drift of its integral from the measured position.

        Near rest, an offset of the velocity sensor would reverse friction. Over times so long that the slope of the position
        is as accurate as the velocity sensor, the position takes precedence.
        """
        noise, period = self.record.noise, self.record.period
        # The slope of a line through n samples scatters by sqrt(12/n³) of theirs, the mean of n samples by 1/sqrt(n).
        samples = math.sqrt(12.0) * noise[POSITION] / (max(noise[VELOCITY], 1e-300) * period)
        window = 2 * round(0.5 * max(samples, self.setup.fit)) + 1
        good, time = self.record.good, self.record.time
        # The position bridges gaps of the velocity sensor, and vice versa.
        velocity = np.where(good[VELOCITY], velocity, self.local_fit(position, 1))
        left = position - integral(velocity, period)
        left = np.interp(time, time[good[POSITION]], left[good[POSITION]])

        def slope(part: Array) -> Array:
            return local_slope(part, window, period) if window < len(part) else np.zeros(len(part))

        return velocity + self.record.by_stretch(slope, left)

    def _keep(self, what: str, key: Any, compute: Any) -> Any:
        kept = self._kept.setdefault(what, {})
        if key in kept:
            value = kept.pop(key)
        else:
            value = compute()
            while len(kept) >= KEPT_RUNS:
                kept.pop(next(iter(kept)))
        kept[key] = value
        return value


def longest_step(use: EffectUse) -> float:
    """Return the longest integration step of an effect along a recording; infinite if nothing is to be integrated [s]."""
    effect = EFFECTS.load(use.name)
    if hasattr(effect, "longest_step"):
        return float(effect.longest_step(use.parameters))
    return MEMORY_STEP if getattr(effect, "STATES", 0) else math.inf


def _remembers(use: EffectUse, hook: str) -> bool:
    """Return whether an effect has a hook, and states that its parameters need."""
    return hasattr(EFFECTS.load(use.name), hook) and math.isfinite(longest_step(use))


def _read(part: str, rig: EffectiveRig) -> tuple[Any, ...]:
    """Return the effects in a part and the plant's coefficients that it reads."""
    return effects_in(part, rig), tuple(getattr(rig.plant, name) for name in coefficients_read(part, rig))


def _areas(rig: EffectiveRig) -> tuple[Any, ...]:
    """Return the areas of both chambers [m^2]; none if the cylinder has one pressure."""
    p = rig.cylinder.parameters
    return (p.area_a, p.area_b) if rig.cylinder.law.CHAMBERS else ()


def _of_side(rig: EffectiveRig, channel: Channel) -> tuple[Any, ...]:
    """Return the parameters of cylinder and valve that the balance of a chamber depends on, beside the supply."""
    if not rig.cylinder.law.CHAMBERS:
        return ()
    others = ("_b", "_pb", "_bt") if channel == "volume_a" else ("_a", "_pa", "_at")
    named = {**rig.cylinder.parameters._asdict(), **rig.valve.parameters._asdict()}
    return tuple(value for key, value in named.items() if not key.endswith(others) and not key.startswith("supply_"))


def _supply(rig: EffectiveRig) -> tuple[Any, ...]:
    """Return the parameters of the supply of a cylinder with two chambers."""
    p = rig.cylinder.parameters
    return (p.supply_resistance, p.supply_time_constant) if rig.cylinder.law.CHAMBERS else ()


def _beam(rig: EffectiveRig) -> tuple[float, ...]:
    """Return the coefficients of (3)."""
    plant = rig.plant
    return (plant.moving_mass, plant.piston_area, plant.viscous_damping, plant.spring_stiffness, plant.gravity)


def formable(signals: Container[str], springless: bool, chambers: bool = False) -> list[Channel]:
    """Return the residuals that can be formed from signals by their names.

    Args:
        signals: the names in the data contract.
        springless: whether the rig has no spring, so that velocity suffices in place of position.
        chambers: whether its cylinder has two chambers.
    """
    moving = POSITION in signals or VELOCITY in signals
    pressure = PRESSURE in signals or FORCE in signals
    opened = SPOOL in signals or COMMAND in signals
    # Two of the chambers' pressures and the driving force; the volumes depend on the position.
    both = (PRESSURE_A in signals) + (PRESSURE_B in signals) + pressure >= 2 and POSITION in signals
    flow = both and opened if chambers else moving and pressure and opened
    there: Mapping[Channel, bool] = {
        "spool": SPOOL in signals and COMMAND in signals,
        "volume": flow and not chambers,
        "volume_a": flow and chambers,
        "volume_b": flow and chambers,
        "supply": flow and SUPPLY in signals,
        # Without a position, the spring force is unknown.
        "force": pressure and (POSITION in signals or (moving and springless)),
        "cell": PRESSURE in signals and FORCE in signals,
        "velocity": POSITION in signals and VELOCITY in signals,
    }
    return [channel for channel, formed in there.items() if formed]


def setup(record: Record, rig: Rig, longest_fit: float = rules.VELOCITY_FIT) -> Setup:
    """Determine which parts of the model can be compared with a recording.

    Args:
        record: the recording.
        rig: the model.
        longest_fit: longest local fit that velocities are taken from [s].
    """
    period = record.period
    # For signals slower than the time base, the windows hold the same number of original samples.
    balanced = record.sampled(*formed_of(record, "force")) / period
    averaged = record.sampled(COMMAND, SPOOL, PRESSURE, FORCE, SUPPLY, PRESSURE_A, PRESSURE_B) / period
    samples = max(round(rules.MIN_WINDOW * balanced), round(rules.WINDOW / period))
    average = smooth_window(max(round(3 * averaged), round(rules.SPOOL_WINDOW / period)), period, hop=2)
    why_not = dict[Stage, str]()
    chambers = rig.cylinder.law.CHAMBERS
    channels = formable(record.signals, springless=rig.plant.spring_stiffness == 0.0, chambers=chambers)
    if "spool" in channels and not command_seen(record, rig):
        channels.remove("spool")
        why_not["valve"] = COMMAND_UNSEEN.format(rate=f"{1.0 / record.sampled(COMMAND, SPOOL):.3g}")
    fit, measured = _velocity_fit(record, longest_fit)
    valve = rig.effective() if COMMAND in record else None
    found = Setup(smooth_window(samples, period), average, tuple(channels), measured, fit, presliding_travel(rig), valve=valve)
    if "force" in channels and np.mean(_friction_known(Comparison(record, found))) < rules.MIN_KEPT_WINDOWS:
        channels.remove("force")
        why_not["force_balance"] = TURNS_UNSEEN.format(rate=f"{1.0 / record.sampled(POSITION, VELOCITY):.3g}")
    lacking = _lacking(Comparison(record, found), rig)
    for stage in STAGES:
        keys = dict.fromkeys(path for c in channels if CHANNELS[c] == stage for path in lacking[c])
        if keys:
            why_not[stage] = NOT_IN_FILE.format(keys=", ".join(keys))
    why_not |= {stage: record.not_judged[stage] for stage in STAGES if stage in record.not_judged}
    left = tuple(c for c in channels if CHANNELS[c] not in record.not_judged and not lacking[c])
    return found._replace(channels=left, why_not=why_not)


def _lacking(comparison: Comparison, rig: Rig) -> dict[Channel, list[str]]:
    """Return the keys missing from the rig file on which each channel's residual depends."""
    paths = [path for path in unknown_keys(rig) if path.startswith("plant.")]
    some = dict.fromkeys((path.removeprefix("plant.") for path in paths), 1.0)
    out: dict[Channel, list[str]] = {channel: [] for channel in CHANNELS}
    if some:
        given = comparison.relevant(rig._replace(plant=rig.plant._replace(**some)))
        for path, key in zip(paths, some, strict=True):
            other = comparison.relevant(rig._replace(plant=rig.plant._replace(**{**some, key: 2.0})))
            for channel, lacks in out.items():
                if other[channel] != given[channel]:
                    lacks.append(path)
    return out


def _velocity_fit(record: Record, longest_fit: float) -> tuple[int, bool]:
    """Return the samples of the local fit of the motion, and whether velocities come from the velocity sensor."""
    sampled = record.sampled(POSITION, VELOCITY)
    errors = {
        (fit, signal == VELOCITY): error
        for signal, polynomial in FITS.items()
        if signal in record
        for fit, error in _fit_errors(record, signal, polynomial, sampled, longest_fit).items()
    }
    fit, measured = (
        min(errors, key=lambda choice: errors[choice]) if errors else (_longest(record, sampled, longest_fit), False)
    )
    return fit, measured and POSITION in record


def moved_by(record: Record, signal: str, by: float) -> tuple[Array, Array]:
    """Return a recorded signal at later and at earlier times, to second order by the local fit that is best for its rate.

    Args:
        record: the recording.
        signal: the signal.
        by: how much later and earlier [s].

    Returns:
        Both signals, each of shape (n,).
    """
    errors = _fit_errors(record, signal, RATE, record.sampled(signal), rules.VELOCITY_FIT)
    fit, values = min(errors, key=errors.__getitem__), record.values(signal)
    rate, bend = (_filtered(record, values, local_row(fit, RATE[0], order, record.period)) for order in (1, 2))
    later, earlier = (values + shift * rate + 0.5 * shift**2 * bend for shift in (by, -by))
    return later, earlier


def _fit_errors(
    record: Record, signal: str, polynomial: tuple[int, int], sampled: float, longest_fit: float
) -> dict[int, float]:
    """Return the error power of a local fit to a signal by its samples.

    A short fit passes noise, and a long one rounds the turns of the velocity, and so the break-away of friction. Rounding shows
    in the difference from the shortest fit, as far as it exceeds that of their noise.

    Args:
        record: the recording.
        signal: the signal.
        polynomial: degree of the fit, and order of the derivative wanted.
        sampled: its own sampling period [s].
        longest_fit: longest fit [s].
    """
    shortest, longest = _shortest(record, sampled), _longest(record, sampled, longest_fit)
    # A fit over the end of a stretch is none of the motion.
    inside = np.ones(len(record.time), dtype=np.bool_)
    for bound in record.bounds:
        inside[max(bound - longest, 0) : bound + longest] = False
    values, variance = record.values(signal), record.noise[signal] ** 2
    shortest_row = local_row(shortest, *polynomial, record.period)
    detailed, errors = _filtered(record, values, shortest_row), dict[int, float]()
    for fit in _lengths(shortest, longest):
        row = local_row(fit, *polynomial, record.period)
        apart = row - np.pad(shortest_row, (fit - shortest) // 2)
        difference = (_filtered(record, values, row) - detailed)[inside]
        rounded = max(0.0, float(np.mean(difference**2)) - variance * float(apart @ apart)) if difference.size else 0.0
        errors[fit] = rounded + variance * float(row @ row)
    return errors


def _shortest(record: Record, sampled: float) -> int:
    """Return the fewest samples of a local fit; through four of a signal's own, a cubic interpolates."""
    return 2 * round(2 * sampled / record.period) + 1


def _longest(record: Record, sampled: float, longest_fit: float) -> int:
    return max(_shortest(record, sampled), 2 * round(longest_fit / record.period / 2) + 1)


def _lengths(shortest: int, longest: int) -> list[int]:
    """Return odd lengths from one to another, a tenth apart at most where they are long."""
    lengths = [shortest]
    while lengths[-1] < longest:
        lengths.append(min(longest, lengths[-1] + 2 * max(1, lengths[-1] // LENGTHENED)))
    return lengths


def _velocity(record: Record, fit: int, *, measured: bool) -> Array:
    """Return the locally fitted velocity, from the velocity sensor or the position, shape (n,) [m/s]."""
    return _filtered(record, record.values(VELOCITY if measured else POSITION), _velocity_row(record, fit, measured=measured))


def _velocity_row(record: Record, fit: int, *, measured: bool) -> Array:
    return local_row(fit, *FITS[VELOCITY if measured else POSITION], record.period)


def _filtered(record: Record, values: Array, row: Array) -> Array:
    """Return a signal filtered by weights about each sample, shape (n,); stretches apart."""
    padded = (row.size // 2, row.size // 2)
    return record.by_stretch(lambda part: np.convolve(np.pad(part, padded, mode="edge"), row[::-1], mode="valid"), values)


def _friction_known(comparison: Comparison) -> Mask:
    """Return the samples at which friction follows from the recorded motion, taken without the sensors' errors."""
    record, used = comparison.record, comparison.setup
    if record.sampled(POSITION, VELOCITY) <= rules.SLOWEST_TURN:
        return np.ones(len(record.time), dtype=np.bool_)
    measured = used.velocity_measured or POSITION not in record
    velocity = _velocity(record, used.fit, measured=measured)
    row = _velocity_row(record, used.fit, measured=measured)
    noise = record.noise[VELOCITY if measured else POSITION] * float(np.linalg.norm(row))
    position = comparison.local_fit(record.values(POSITION), 0) if POSITION in record else np.cumsum(velocity) * record.period
    return friction_known(record, position, velocity, used.presliding, noise)


def _forgotten(comparison: Comparison, rig: Rig) -> Mask:
    """Return the samples of each stretch at which friction no longer depends on its unknown force at the beginning.

    That is after the first sliding: between sliding in one direction and in the other, the piston moves by twice the
    presliding travel. From then on, the model tells how fast it forgets.
    """
    record, effective = comparison.record, rig.effective()
    position = record.values(POSITION) if POSITION in record else integral(record.values(VELOCITY), record.period)
    moved = record.by_stretch(lambda part: np.maximum.accumulate(np.abs(part - part[0])), position)
    slid = moved >= 2.0 * comparison.setup.presliding
    since = record.by_stretch(lambda part: np.cumsum(part) / len(part), slid.astype(np.float64))
    known = comparison.friction_range(effective) <= FORGOTTEN * effective.friction_level(math.inf)
    return slid & (known | (since > LONGEST_MEMORY))


def formed_of(record: Record, channel: Channel) -> tuple[str, ...]:
    """Return the recorded signals from which a channel is formed, those whose noise affects its residual most first.

    The load cell replaces a missing pressure, and the command a missing spool.
    """
    spare = FORCE if PRESSURE in record and channel != "cell" else ""
    named = (COMMAND if signal == SPOOL and SPOOL not in record else signal for signal in KINDS[channel].needed)
    return tuple(signal for signal in named if signal in record and signal != spare)


def usable(comparison: Comparison, channel: Channel, rig: Rig) -> Mask:
    """Return the windows of a channel with measured samples only, away from the beginning of a stretch.

    Args:
        comparison: the recording and its setup.
        channel: the channel.
        rig: the given model, for the memory of its friction.
    """
    record, used = comparison.record, comparison.setup
    good = np.ones(len(record.time), dtype=np.bool_)
    for signal in formed_of(record, channel):
        good &= record.good[signal]
    if channel == "spool":
        # After a gap in the command, the simulated spool recovers with the valve's lag.
        wrong = (~record.good[COMMAND]).astype(np.float64)
        good &= np.convolve(wrong, np.ones(1 + round(rules.SPOOL_SETTLING / record.period)))[: len(wrong)] < 0.5
    if channel == "force":
        good &= _friction_known(comparison) & _forgotten(comparison, rig)
    window = used.window_of(channel)
    settling = round(rules.SETTLING / record.period)
    late = np.ones(len(good), dtype=np.bool_)
    for begin in np.flatnonzero(record.fresh):
        late[begin : begin + settling] = False
        late[max(begin - window.weights.size, 0) : begin] = False
    late[-max(1, round(rules.SPOOL_SETTLING / record.period)) :] = False
    return window.mean((good & late).astype(np.float64)) > 1.0 - 1e-9
