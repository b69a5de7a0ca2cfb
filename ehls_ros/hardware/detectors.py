"""What the safety gate sees wrong in the rig's readings."""

import math
from collections.abc import Collection, Mapping, Sequence

from ehls_ros.hardware.gate_parameters import REACTIONS, Parameters
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.physics.sensors import FORCE, LOAD_PRESSURE, OIL_TEMPERATURE, POSITION, SPOOL, SUPPLY_PRESSURE, VELOCITY

SPEED_TIME = 0.005
"""Time constant of the speed taken from positions, where no velocity is measured [s]."""

DRIFT_TIME = 0.1
"""Time over which travel is compared with integrated velocity [s]."""

MODEL_MARGIN = 1.25
"""The load pressure may move so many times as fast as valve, oil and cylinder of the rig file make it."""

SPREAD = 8.0
"""A reading may scatter by so many standard deviations of its noise."""

OIL_RANGE = (200.0, 450.0)
"""Temperatures oil can have [K]."""

UNITS = ("m", "m/s", "Pa", "m", "N", "Pa", "K")
"""Of the readings, in the order of ``SENSED``."""

OIL_RATE = 1e3
"""Largest rate of the oil's temperature [K/s]."""


class Detector:
    """One kind of fault: whether it is there, since when, and how often it has been.

    Attributes:
        name: what it is called in diagnostics.
        parameter: name of the parameter that says its reaction; empty: it cuts, whatever is wanted.
        unit: of value and limit.
        reaction: index into ``REACTIONS``.
        raised: whether the fault is there.
        value: the offending value.
        limit: the limit in force; infinite where there is none or it depends on the signal.
        subject: the signal or sender it is about, where there are several.
        count: how often the fault came up.
        seen: the gate's own time when it was there last [s].
    """

    __slots__ = ("count", "lasted", "limit", "name", "parameter", "raised", "reaction", "seen", "subject", "unit", "value")

    def __init__(self, name: str, unit: str, parameter: str | None = None) -> None:
        """Start without a fault; the reaction is set by :meth:`retune`, and a cut where no parameter names one."""
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
        """Take the reaction from a parameter set."""
        if self.parameter:
            self.reaction = REACTIONS.index(getattr(parameters, self.parameter))

    def look(self, wrong: bool, value: float, limit: float, elapsed: float = 0.0, lasting: float = 0.0) -> None:
        """Take one more observation.

        Args:
            wrong: whether it is a violation.
            value: what was seen.
            limit: what it is held against.
            elapsed: time since the observation before [s].
            lasting: time the violation must last to count [s].
        """
        if not wrong:
            self.raised = False
            self.lasted = 0.0
            return
        self.limit = limit
        self.lasted += elapsed
        # A clock's rounding must not make it one cycle longer.
        if not self.raised and self.lasted >= lasting - 1e-9:
            self.raised = True
            self.value = value
            self.count += 1

    def again(self, value: float, limit: float, subject: str) -> None:
        """Count a fault that lasts for one message; it stays raised until the gate's next step."""
        self.raised = True
        self.value, self.limit, self.subject = value, limit, subject
        self.count += 1


def sensor_detectors() -> tuple[Detector, ...]:
    """Return the detectors that :class:`Readings` looks after."""
    return (
        Detector("force", "N"),
        Detector("load_pressure", "Pa"),
        Detector("velocity", "m/s"),
        Detector("position", "m"),
        Detector("force_error", "N"),
        Detector("sensor_not_finite", ""),
        Detector("sensor_range", ""),
        Detector("sensor_jump", ""),
        Detector("sensor_frozen", "m"),
        Detector("force_mismatch", "N", "on_sensor_mismatch"),
        Detector("position_mismatch", "m", "on_sensor_mismatch"),
        Detector("supply_mismatch", "Pa", "on_sensor_mismatch"),
    )


class Signal:
    """One measured signal: what it may be, and what it was.

    Attributes:
        name: as in ``SENSED``.
        index: its place there.
        unit: of its readings.
        low: smallest true reading.
        high: largest true reading.
        rate: fastest true change, per second.
        scatter: how far two readings of the same value may lie apart.
        moves: whether it must change when the command does.
        good: last reading that was possible; NaN before the first.
        gap: time since that [s].
        last: last reading.
        still: how long it has been the same [s].
        lowest: smallest command written in that time [m].
        highest: largest command written in that time [m].
    """

    __slots__ = (
        "gap", "good", "high", "highest", "index", "last", "low", "lowest", "moves", "name", "rate", "scatter", "still", "unit",
    )  # fmt: skip

    def __init__(self, index: int, sensor: Sensor) -> None:
        """Start without a reading; range and rate are set by :meth:`Readings.retune`."""
        self.name = SENSED[index]
        self.index = index
        self.unit = UNITS[index]
        self.low = self.high = self.rate = math.nan
        self.scatter = 2.0 * SPREAD * sensor.noise_std + 2.0 * sensor.resolution
        self.moves = index not in {SUPPLY_PRESSURE, OIL_TEMPERATURE}
        self.good = self.last = math.nan
        self.gap = self.still = self.lowest = self.highest = 0.0


class Readings:
    """The snapshots that come in, looked at one by one."""

    def __init__(self, rig: Rig, measured: Collection[str], parameters: Parameters, detectors: Mapping[str, Detector]) -> None:
        """Prepare.

        Args:
            rig: for its limits, its sensors' noise and the supply pressure.
            measured: the signals of ``SENSED`` the rig measures.
            parameters: the limits.
            detectors: by name, from :func:`sensor_detectors`.
        """
        self._rig = rig
        self._signals = [Signal(i, rig.sensors.get(s, Sensor())) for i, s in enumerate(SENSED) if s in measured]
        self._has = [signal in measured for signal in SENSED]
        (
            self._force, self._pressure, self._velocity, self._position, self._error,
            self._not_finite, self._range, self._jump, self._frozen,
            self._force_mismatch, self._position_mismatch, self._supply_mismatch,
        ) = (detectors[detector.name] for detector in sensor_detectors())  # fmt: skip
        plant = rig.plant
        self._stiffness = 4.0 * plant.bulk_modulus / plant.total_volume
        self._flow = plant.discharge_coefficient * plant.valve_area_gradient / math.sqrt(plant.oil_density)
        self._lag = 1.0 / plant.valve_bandwidth
        self.begin()
        self.retune(parameters)

    def begin(self) -> None:
        """Forget the snapshots so far: the next one follows none."""
        self._drift = self._speed = self._opening = 0.0
        self._last_position = self._last_velocity = math.nan
        for signal in self._signals:
            signal.good = signal.last = math.nan
            signal.gap = signal.still = signal.lowest = signal.highest = 0.0

    def retune(self, parameters: Parameters) -> None:
        """Put other limits in force."""
        self._p = parameters
        limits, part = self._rig.limits, parameters.trip_level
        self._force_limit = part * limits.force
        self._pressure_limit = part * limits.load_pressure
        self._velocity_limit = part * limits.velocity
        self._lowest = limits.position[0] + parameters.position_margin
        self._highest = limits.position[1] - parameters.position_margin
        for detector, limit in (
            (self._force, self._force_limit),
            (self._pressure, self._pressure_limit),
            (self._velocity, self._velocity_limit),
            (self._position, self._highest),
            (self._error, parameters.force_error),
            (self._frozen, parameters.frozen_command),
            (self._force_mismatch, parameters.force_mismatch),
            (self._position_mismatch, parameters.position_mismatch),
            (self._supply_mismatch, parameters.supply_mismatch),
        ):
            detector.limit = limit
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
            # From one limit to the other, the valve's lag starts with this.
            SPOOL: wide * 2.0 * limits.spool * plant.valve_bandwidth * max(1.0, plant.valve_gain),
            FORCE: plant.piston_area * self._p.pressure_rate,
            SUPPLY_PRESSURE: self._p.pressure_rate,
            OIL_TEMPERATURE: OIL_RATE,
        }[index]

    def look(self, values: Sequence[float], elapsed: float, written: float, reference: float) -> None:
        """Look at one new snapshot.

        Args:
            values: readings in the order of ``SENSED``, finite or NaN.
            elapsed: time since the snapshot before [s].
            written: the command last written [m].
            reference: what the force should be [N]; NaN where nobody knows.
        """
        self._follow_flow(values, elapsed, written)
        self._look_at_signals(values, elapsed, written)
        self._look_at_limits(values, elapsed, written, reference)
        self._look_at_mismatches(values, elapsed)

    def _follow_flow(self, values: Sequence[float], elapsed: float, written: float) -> None:
        """Bound the rate of the load pressure by what valve and piston can move: equations (1) and (2)."""
        plant = self._rig.plant
        # The spool follows with its lag, so that it may stand open while the command is back at null.
        self._opening = max(abs(plant.valve_gain * written), self._opening * math.exp(-elapsed / self._lag))
        opening = max(self._opening, abs(self._known(SPOOL, values, 0.0)))
        head = plant.supply_pressure + abs(self._known(LOAD_PRESSURE, values, plant.supply_pressure))
        speed = abs(self._known(VELOCITY, values, self._speed))
        flow = self._flow * opening * math.sqrt(head) + plant.piston_area * speed
        rate = max(self._p.pressure_rate, MODEL_MARGIN * self._stiffness * flow)
        for signal in self._signals:
            if signal.index == LOAD_PRESSURE:
                signal.rate = rate
            elif signal.index == FORCE:
                signal.rate = plant.piston_area * rate

    def _known(self, index: int, values: Sequence[float], otherwise: float) -> float:
        """Return a reading, or something else where it is not measured or no number."""
        return values[index] if self._has[index] and math.isfinite(values[index]) else otherwise

    def _look_at_signals(self, values: Sequence[float], elapsed: float, written: float) -> None:
        p = self._p
        not_finite = impossible = jumped = frozen = None
        jump = 0.0
        for signal in self._signals:
            value = values[signal.index]
            signal.gap += elapsed
            if not math.isfinite(value):
                not_finite = not_finite or signal
                continue
            if not signal.low <= value <= signal.high:
                impossible = impossible or signal
            elif abs(value - signal.good) > signal.rate * signal.gap + signal.scatter:
                if jumped is None:
                    jumped, jump = signal, (value - signal.good) / signal.gap if signal.gap > 0.0 else math.inf
            else:
                signal.good, signal.gap = value, 0.0
            if value != signal.last or not signal.moves:
                signal.last, signal.still = value, 0.0
                signal.lowest = signal.highest = written
                continue
            signal.still += elapsed
            signal.lowest, signal.highest = min(signal.lowest, written), max(signal.highest, written)
            if signal.still >= p.frozen_time and signal.highest - signal.lowest >= p.frozen_command:
                frozen = frozen or signal
        _tell(self._not_finite, not_finite, values[not_finite.index] if not_finite else 0.0, math.inf)
        _tell(
            self._range,
            impossible,
            values[impossible.index] if impossible else 0.0,
            impossible.high if impossible else math.inf,
        )
        _tell(self._jump, jumped, jump, jumped.rate if jumped else math.inf, "/s")
        _tell(self._frozen, frozen, frozen.highest - frozen.lowest if frozen else 0.0, p.frozen_command)

    def _look_at_limits(self, values: Sequence[float], elapsed: float, written: float, reference: float) -> None:
        p, has = self._p, self._has
        if has[FORCE]:
            force = values[FORCE]
            self._force.look(abs(force) > self._force_limit, force, self._force_limit, elapsed, p.limit_time)
            error = force - reference
            self._error.look(abs(error) > p.force_error, error, p.force_error, elapsed, p.force_error_time)
        if has[LOAD_PRESSURE]:
            pressure = values[LOAD_PRESSURE]
            self._pressure.look(abs(pressure) > self._pressure_limit, pressure, self._pressure_limit, elapsed, p.limit_time)
        if has[POSITION]:
            position = values[POSITION]
            upper = position > self._highest
            # Beyond a limit, only the way back is open.
            wrong = (upper and written > 0.0) or (position < self._lowest and written < 0.0)
            self._position.look(wrong, position, self._highest if upper else self._lowest, elapsed, p.limit_time)
        speed = values[VELOCITY] if has[VELOCITY] else self._speed_from(values[POSITION], elapsed)
        self._velocity.look(abs(speed) > self._velocity_limit, speed, self._velocity_limit, elapsed, p.limit_time)

    def _speed_from(self, position: float, elapsed: float) -> float:
        """Return the speed by positions, smoothed; 0 without a position."""
        change = position - self._last_position
        if math.isfinite(change) and elapsed > 0.0:
            self._speed += (change / elapsed - self._speed) * elapsed / (SPEED_TIME + elapsed)
        self._last_position = position
        return self._speed

    def _look_at_mismatches(self, values: Sequence[float], elapsed: float) -> None:
        p, has = self._p, self._has
        if has[FORCE] and has[LOAD_PRESSURE]:
            apart = values[FORCE] - self._rig.plant.piston_area * values[LOAD_PRESSURE]
            self._force_mismatch.look(abs(apart) > p.force_mismatch, apart, p.force_mismatch, elapsed, p.mismatch_time)
        if has[POSITION] and has[VELOCITY]:
            position, velocity = values[POSITION], values[VELOCITY]
            missed = position - self._last_position - 0.5 * (velocity + self._last_velocity) * elapsed
            if math.isfinite(missed):
                self._drift = (self._drift + missed) * DRIFT_TIME / (DRIFT_TIME + elapsed)
            self._last_position, self._last_velocity = position, velocity
            self._position_mismatch.look(
                abs(self._drift) > p.position_mismatch, self._drift, p.position_mismatch, elapsed, p.mismatch_time
            )
        if has[LOAD_PRESSURE]:
            supply = values[SUPPLY_PRESSURE] if has[SUPPLY_PRESSURE] else self._rig.plant.supply_pressure
            above = abs(values[LOAD_PRESSURE]) - supply
            self._supply_mismatch.look(above > p.supply_mismatch, above, p.supply_mismatch, elapsed, p.mismatch_time)


def _tell(detector: Detector, signal: Signal | None, value: float, limit: float, per: str = "") -> None:
    """Show a detector the first signal in which its fault is, if there is one; ``per`` is appended to the signal's unit."""
    if signal is not None:
        if not detector.raised:
            detector.subject = signal.name
            detector.unit = detector.unit if detector.name == "sensor_frozen" else f"{signal.unit}{per}"
        detector.look(True, value, limit)
    elif detector.raised:
        detector.look(False, 0.0, limit)
