"""Fault detectors of the safety gate, and the checks of the rig's readings."""

import math
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from ehls_ros.hardware.gate_parameters import REACTIONS, Parameters
from ehls_ros.hardware.specimen import Specimen
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.physics.sensors import FORCE, LOAD_PRESSURE, OIL_TEMPERATURE, POSITION, SPOOL, SUPPLY_PRESSURE, VELOCITY

SPEED_TIME = 0.005
"""Time constant of the speed computed from positions, where no velocity is measured [s]."""

DRIFT_TIME = 0.1
"""Time over which travel is compared with integrated velocity [s]."""

MODEL_MARGIN = 1.25
"""Margin on the load pressure rate computed from the rig file's valve, oil and cylinder."""

SPREAD = 8.0
"""Permitted scatter of a reading, in standard deviations of its noise."""

ANSWER = 3
"""Cycles after which a reading answers a change of the command, beside the valve's time constant."""

OIL_RANGE = (200.0, 450.0)
"""Possible oil temperatures [K]."""

UNITS = ("m", "m/s", "Pa", "m", "N", "Pa", "K")
"""Units of the readings, in the order of ``SENSED``."""

OIL_RATE = 1e3
"""Largest rate of the oil temperature [K/s]."""


class Violation(NamedTuple):
    """A limit broken by one signal.

    Attributes:
        signal: as in ``SENSED``.
        value: the offending value.
        limit: the limit it broke.
        unit: of both.
    """

    signal: str
    value: float
    limit: float
    unit: str


class Detector:
    """One kind of fault: its presence, duration and number of occurrences.

    Attributes:
        name: in diagnostics.
        parameter: name of the parameter that sets the reaction; empty: always a cut.
        unit: of value and limit.
        reaction: index into ``REACTIONS``.
        raised: whether the fault is present.
        value: the offending value.
        limit: the limit in force; infinite if there is none or it depends on the signal.
        subject: the signal or sender concerned, where there are several.
        count: number of occurrences.
        seen: time on the gate's clock when the fault was last present [s].
    """

    __slots__ = ("count", "lasted", "limit", "name", "parameter", "raised", "reaction", "seen", "subject", "unit", "value")

    def __init__(self, name: str, unit: str, parameter: str | None = None) -> None:
        """Start without a fault; :meth:`retune` sets the reaction, which is a cut if there is no parameter for it."""
        self.name = name
        self.parameter = f"on_{name}" if parameter is None else parameter
        self.unit = unit
        self.reaction = len(REACTIONS) - 1
        self.raised = False
        self.lasted = 0.0
        self.value = 0.0
        self.limit = math.inf
        self.subject = ""
        self.count = 0
        self.seen = -math.inf

    def retune(self, parameters: Parameters) -> None:
        """Set the reaction from a parameter set."""
        if self.parameter:
            self.reaction = REACTIONS.index(getattr(parameters, self.parameter))

    def look(self, wrong: bool, value: float, limit: float, elapsed: float = 0.0, lasting: float = 0.0) -> None:
        """Record an observation.

        Args:
            wrong: whether it is a violation.
            value: observed value.
            limit: the limit it is compared with.
            elapsed: time since the previous observation [s].
            lasting: time the violation must last to raise the fault [s].
        """
        if not wrong:
            self.raised = False
            self.lasted = 0.0
            return
        self.lasted += elapsed
        if self.raised:
            # Value and limit are those of the moment the fault was raised: of the same signal, in the same unit.
            return
        self.limit = limit
        # Rounding of the clock must not add a cycle.
        if self.lasted >= lasting - 1e-9:
            self.raised = True
            self.value = value
            self.count += 1

    def compare(self, value: float, elapsed: float, lasting: float) -> None:
        """Record an observation whose magnitude may not exceed the limit in force; arguments as for :meth:`look`."""
        self.look(abs(value) > self.limit, value, self.limit, elapsed, lasting)

    def flag(self, value: float, limit: float, subject: str) -> None:
        """Raise a fault of a single message; it stays raised until the gate's next step."""
        self.raised = True
        self.value, self.limit, self.subject = value, limit, subject
        self.count += 1

    def report(self, violation: Violation | None) -> None:
        """Raise the fault for the first signal that shows it; clear it if there is none."""
        if violation is None:
            self.look(False, 0.0, self.limit)
            return
        if not self.raised:
            self.subject, self.unit = violation.signal, violation.unit
        self.look(True, violation.value, violation.limit)


class SensorDetectors:
    """The detectors of faults in the readings."""

    def __init__(self) -> None:
        """Start without faults."""
        self.force = Detector("force", "N")
        self.load_pressure = Detector("load_pressure", "Pa")
        self.velocity = Detector("velocity", "m/s")
        self.position = Detector("position", "m")
        self.force_error = Detector("force_error", "N")
        self.not_finite = Detector("sensor_not_finite", "")
        self.out_of_range = Detector("sensor_range", "")
        self.jump = Detector("sensor_jump", "")
        self.frozen = Detector("sensor_frozen", "m")
        self.force_mismatch = Detector("force_mismatch", "N", "on_sensor_mismatch")
        self.position_mismatch = Detector("position_mismatch", "m", "on_sensor_mismatch")
        self.supply_mismatch = Detector("supply_mismatch", "Pa", "on_sensor_mismatch")
        self.specimen = Detector("specimen", "")

    def __iter__(self) -> Iterator[Detector]:
        """Yield all of them."""
        yield from vars(self).values()


class Signal:
    """One measured signal: its plausible range and rate, and its recent history.

    Attributes:
        name: as in ``SENSED``.
        index: position in ``SENSED``.
        unit: of the readings.
        low: smallest plausible reading.
        high: largest plausible reading.
        rate: fastest plausible change, per second.
        scatter: largest difference of two readings of the same value.
        moves: whether it must change when the command does.
        good: last plausible reading; NaN before the first.
        gap: time since then [s].
        last: last reading.
        still: time for which the reading has not changed [s].
        lowest: smallest command written in that time [m].
        highest: largest command written in that time [m].
        unanswered: time since these span enough for the reading to answer, less that of :data:`ANSWER` cycles [s].
    """

    __slots__ = (
        "gap", "good", "high", "highest", "index", "last", "low", "lowest", "moves", "name", "rate", "scatter", "still",
        "unanswered", "unit",
    )  # fmt: skip

    def __init__(self, index: int, sensor: Sensor) -> None:
        """Start without a reading; :meth:`Readings.retune` sets range and rate."""
        self.name = SENSED[index]
        self.index = index
        self.unit = UNITS[index]
        self.low = self.high = self.rate = math.nan
        self.scatter = 2.0 * SPREAD * sensor.noise_std + 2.0 * sensor.resolution
        self.moves = index not in {SUPPLY_PRESSURE, OIL_TEMPERATURE}
        self.good = self.last = math.nan
        self.gap = self.still = self.lowest = self.highest = self.unanswered = 0.0


class Readings:
    """Checks each snapshot against the limits, the plausible ranges and rates, and the other signals."""

    def __init__(self, rig: Rig, measured: Collection[str], parameters: Parameters, detectors: SensorDetectors) -> None:
        """Start without a snapshot.

        Args:
            rig: for its limits, sensor noise and supply pressure.
            measured: the signals of ``SENSED`` that the rig measures.
            parameters: the limits.
            detectors: to update.
        """
        self._rig = rig
        self._signals = [Signal(i, rig.sensors.get(s, Sensor())) for i, s in enumerate(SENSED) if s in measured]
        self._by_index = {signal.index: signal for signal in self._signals}
        self._has = [signal in measured for signal in SENSED]
        self._detectors = detectors
        plant = rig.plant
        self._stiffness = 4.0 * plant.bulk_modulus / plant.total_volume
        self._flow = plant.discharge_coefficient * plant.valve_area_gradient / math.sqrt(plant.oil_density)
        self._lag = 1.0 / plant.valve_bandwidth
        self._specimen = Specimen(plant.moving_mass, rig.limits.force, rig.sensors.get("position", Sensor()))
        self.begin()
        self.retune(parameters)

    def begin(self) -> None:
        """Forget the previous snapshots."""
        self._drift = self._speed = self._opening = 0.0
        self._last_position = self._last_velocity = math.nan
        for signal in self._signals:
            signal.good = signal.last = math.nan
            signal.gap = signal.still = signal.lowest = signal.highest = signal.unanswered = 0.0
        self._has_specimen = False
        self._specimen.forget()

    def retune(self, parameters: Parameters) -> None:
        """Apply other limits."""
        self._p = parameters
        limits, level, detectors = self._rig.limits, parameters.trip_level, self._detectors
        self._lowest = limits.position[0] + parameters.position_margin
        self._highest = limits.position[1] - parameters.position_margin
        detectors.force.limit = level * limits.force
        detectors.load_pressure.limit = level * limits.load_pressure
        detectors.velocity.limit = level * limits.velocity
        detectors.position.limit = self._highest
        detectors.force_error.limit = parameters.force_error
        detectors.frozen.limit = parameters.frozen_command
        detectors.force_mismatch.limit = parameters.force_mismatch
        detectors.position_mismatch.limit = parameters.position_mismatch
        detectors.supply_mismatch.limit = parameters.supply_mismatch
        detectors.specimen.limit = 1.0 - parameters.stiffness_drop if parameters.stiffness_drop < 1.0 else math.inf
        for signal in self._signals:
            signal.low, signal.high = self._range_of(signal.index)
            signal.rate = self._rate_of(signal.index)

    def _range_of(self, index: int) -> tuple[float, float]:
        limits, wide = self._rig.limits, self._p.sensor_range
        low, high = limits.position
        middle, reach = 0.5 * (low + high), 0.5 * wide * (high - low)
        supply = self._rig.plant.supply_pressure
        return {
            POSITION: (middle - reach, middle + reach),
            VELOCITY: (-wide * limits.velocity, wide * limits.velocity),
            LOAD_PRESSURE: (-wide * limits.load_pressure, wide * limits.load_pressure),
            SPOOL: (-wide * limits.spool, wide * limits.spool),
            FORCE: (-wide * limits.force, wide * limits.force),
            SUPPLY_PRESSURE: (-0.1 * supply, wide * supply),
            OIL_TEMPERATURE: OIL_RANGE,
        }[index]

    def _rate_of(self, index: int) -> float:
        limits, plant, wide = self._rig.limits, self._rig.plant, self._p.sensor_range
        return {
            POSITION: wide * limits.velocity,
            VELOCITY: self._p.acceleration,
            LOAD_PRESSURE: self._p.pressure_rate,
            # Initial rate of the first-order valve for a step from one limit to the other.
            SPOOL: wide * 2.0 * limits.spool * plant.valve_bandwidth * max(1.0, plant.valve_gain),
            FORCE: plant.piston_area * self._p.pressure_rate,
            SUPPLY_PRESSURE: self._p.pressure_rate,
            OIL_TEMPERATURE: OIL_RATE,
        }[index]

    @property
    def position(self) -> float:
        """Position of the piston in the last snapshot [m]; NaN if it is not measured or implausible."""
        return self._sound(POSITION)

    @property
    def pressure(self) -> float:
        """Load pressure in the last snapshot, from the force where it is not measured [Pa]; NaN if it is implausible."""
        return self._sound(LOAD_PRESSURE) if self._has[LOAD_PRESSURE] else self._sound(FORCE) / self._rig.plant.piston_area

    def _sound(self, index: int) -> float:
        signal = self._by_index.get(index)
        if signal is None or signal.gap > 0.0 or self._is_frozen(signal):
            return math.nan
        return signal.good

    def _is_frozen(self, signal: Signal) -> bool:
        # A reading that was still at a steady command has the time to answer its first change.
        return signal.still >= self._p.frozen_time and signal.unanswered > self._lag

    def look(self, values: Sequence[float], elapsed: float, written: float, reference: float, *, driving: bool) -> None:
        """Check a new snapshot.

        Args:
            values: readings in the order of ``SENSED``, finite or NaN.
            elapsed: time since the previous snapshot [s].
            written: the command last written [m].
            reference: force reference [N]; NaN if unknown.
            driving: whether commands reach the actuator.
        """
        self._follow_flow(values, elapsed, written)
        self._look_at_signals(values, elapsed, written)
        self._look_at_limits(values, elapsed, written, reference)
        self._look_at_mismatches(values, elapsed)
        self._look_at_specimen(values, elapsed, driving=driving)

    def _follow_flow(self, values: Sequence[float], elapsed: float, written: float) -> None:
        """Bound the rate of the load pressure by the flow of valve and piston: equations (1) and (2)."""
        plant = self._rig.plant
        # The spool lags and may still be open when the command is back at null.
        self._opening = max(abs(plant.valve_gain * written), self._opening * math.exp(-elapsed / self._lag))
        opening = max(self._opening, abs(self._known(SPOOL, values, 0.0)))
        head = plant.supply_pressure + abs(self._known(LOAD_PRESSURE, values, plant.supply_pressure))
        # A piston that swings on the oil may be faster between two samples than at the second.
        speed = max(abs(self._known(VELOCITY, values, self._speed)), abs(self._last_velocity))
        flow = self._flow * opening * math.sqrt(head) + plant.piston_area * speed
        rate = max(self._p.pressure_rate, MODEL_MARGIN * self._stiffness * flow)
        for signal in self._signals:
            if signal.index == LOAD_PRESSURE:
                signal.rate = rate
            elif signal.index == FORCE:
                signal.rate = plant.piston_area * rate

    def _known(self, index: int, values: Sequence[float], otherwise: float) -> float:
        """Return a reading, or a substitute if it is not measured or NaN."""
        return values[index] if self._has[index] and math.isfinite(values[index]) else otherwise

    def _look_at_signals(self, values: Sequence[float], elapsed: float, written: float) -> None:
        p = self._p
        not_finite = impossible = jumped = frozen = None
        for signal in self._signals:
            value = values[signal.index]
            signal.gap += elapsed
            if not math.isfinite(value):
                not_finite = not_finite or Violation(signal.name, value, math.inf, signal.unit)
                continue
            if not signal.low <= value <= signal.high:
                impossible = impossible or Violation(signal.name, value, signal.high, signal.unit)
            elif abs(value - signal.good) > signal.rate * signal.gap + signal.scatter:
                rate = (value - signal.good) / signal.gap if signal.gap > 0.0 else math.inf
                jumped = jumped or Violation(signal.name, rate, signal.rate, f"{signal.unit}/s")
            else:
                signal.good, signal.gap = value, 0.0
            if value != signal.last or not signal.moves:
                signal.last, signal.still = value, 0.0
                signal.lowest = signal.highest = written
                continue
            signal.still += elapsed
            signal.lowest, signal.highest = min(signal.lowest, written), max(signal.highest, written)
            spans = signal.highest - signal.lowest >= p.frozen_command
            signal.unanswered = signal.unanswered + elapsed if spans else -ANSWER * elapsed
            if self._is_frozen(signal):
                frozen = frozen or Violation(signal.name, signal.highest - signal.lowest, p.frozen_command, "m")
        self._detectors.not_finite.report(not_finite)
        self._detectors.out_of_range.report(impossible)
        self._detectors.jump.report(jumped)
        self._detectors.frozen.report(frozen)

    def _look_at_limits(self, values: Sequence[float], elapsed: float, written: float, reference: float) -> None:
        p, has, detectors = self._p, self._has, self._detectors
        if has[FORCE]:
            detectors.force.compare(values[FORCE], elapsed, p.limit_time)
            detectors.force_error.compare(values[FORCE] - reference, elapsed, p.force_error_time)
        if has[LOAD_PRESSURE]:
            detectors.load_pressure.compare(values[LOAD_PRESSURE], elapsed, p.limit_time)
        if has[POSITION]:
            position = values[POSITION]
            upper = position > self._highest
            # Beyond a limit, commands back into the stroke are permitted.
            wrong = (upper and written > 0.0) or (position < self._lowest and written < 0.0)
            detectors.position.look(wrong, position, self._highest if upper else self._lowest, elapsed, p.limit_time)
        speed = values[VELOCITY] if has[VELOCITY] else self._speed_from(values[POSITION], elapsed)
        detectors.velocity.compare(speed, elapsed, p.limit_time)

    def _speed_from(self, position: float, elapsed: float) -> float:
        """Return the smoothed derivative of the position; unchanged while a position is missing."""
        change = position - self._last_position
        if math.isfinite(change) and elapsed > 0.0:
            self._speed += (change / elapsed - self._speed) * elapsed / (SPEED_TIME + elapsed)
        self._last_position = position
        return self._speed

    def _look_at_mismatches(self, values: Sequence[float], elapsed: float) -> None:
        p, has, detectors = self._p, self._has, self._detectors
        if has[FORCE] and has[LOAD_PRESSURE]:
            difference = values[FORCE] - self._rig.plant.piston_area * values[LOAD_PRESSURE]
            detectors.force_mismatch.compare(difference, elapsed, p.mismatch_time)
        if has[POSITION] and has[VELOCITY]:
            position, velocity = values[POSITION], values[VELOCITY]
            missed = position - self._last_position - 0.5 * (velocity + self._last_velocity) * elapsed
            if math.isfinite(missed):
                self._drift = (self._drift + missed) * DRIFT_TIME / (DRIFT_TIME + elapsed)
            self._last_position, self._last_velocity = position, velocity
            detectors.position_mismatch.compare(self._drift, elapsed, p.mismatch_time)
        if has[LOAD_PRESSURE]:
            supply = values[SUPPLY_PRESSURE] if has[SUPPLY_PRESSURE] else self._rig.plant.supply_pressure
            excess = abs(values[LOAD_PRESSURE]) - supply
            detectors.supply_mismatch.look(excess > p.supply_mismatch, excess, p.supply_mismatch, elapsed, p.mismatch_time)

    def _look_at_specimen(self, values: Sequence[float], elapsed: float, *, driving: bool) -> None:
        drop, detector, has = self._p.stiffness_drop, self._detectors.specimen, self._has
        if not driving or drop == 1.0:
            if self._has_specimen:
                # Once the valve has closed, the specimen may be replaced.
                self._has_specimen = False
                self._specimen.forget()
                detector.look(False, 0.0, detector.limit)
            return
        self._has_specimen = True
        force = values[FORCE] if has[FORCE] else self._rig.plant.piston_area * values[LOAD_PRESSURE]
        short, fraction = self._specimen.look(values[POSITION], values[VELOCITY], force, elapsed, drop)
        detector.look(short, fraction, detector.limit, elapsed, self._p.limit_time)
