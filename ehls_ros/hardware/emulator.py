"""Emulated rig behind its converters: simulated plant, disturbance, sensors and quantisation."""

from typing import Any, Protocol

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.disturbances.base import FORCE_RATE, VELOCITY, Source
from ehls_ros.hardware.calibration import Calibration, Input, Output, step
from ehls_ros.hardware.faults import Faults
from ehls_ros.hardware.packet import Status
from ehls_ros.hardware.truth_log import TruthLog
from ehls_ros.physics import sensors
from ehls_ros.physics.plant import V, X
from ehls_ros.physics.rig import EVERY_SENSED

BLOCK = 1024
"""Number of cycles per computed block of noise and disturbance."""

LOGGED = [
    sensors.SPOOL, sensors.LOAD_PRESSURE, sensors.SUPPLY_PRESSURE, sensors.POSITION, sensors.VELOCITY, sensors.FORCE,
    sensors.OIL_TEMPERATURE,
]  # fmt: skip
"""True signals in the order of the log."""


class Steppable(Protocol):
    """Part of the interface of :class:`ehls_ros.physics.simulator.Simulator` used by the emulator."""

    period: float
    cycle: int
    servo: Array
    truth: Array

    def measure(self, noise: Array) -> Array:
        """Read the sensors, given standard normal numbers."""

    def advance(self, command: float, force: float, force_rate: float, displacement: float, velocity: float) -> Any:
        """Integrate over one period."""


def converted(value: float, channel: Input | Output) -> float:
    """Return the nearest raw value that a channel's converter can represent."""
    low, high = channel.range
    size = step(channel)
    code = round((min(max(value, low), high) - low) / size)
    return low + size * min(code, (1 << channel.bits) - 1)


class Emulator:
    """The emulated rig; each cycle is one :meth:`sense` and one :meth:`advance`.

    Attributes:
        faults: injected into the sensors and the network.
        log: the true signals, or None.
    """

    def __init__(
        self,
        simulator: Steppable,
        disturbance: Source,
        calibration: Calibration,
        seed: int,
        *,
        disturb_at_once: bool = False,
        disturb_after: float = 0.0,
        log: TruthLog | None = None,
    ) -> None:
        """Connect the parts.

        Args:
            simulator: the plant with its sensors.
            disturbance: of the actuator under test; for a servo that the plant simulates, the motion to follow.
            calibration: of the rig's channels.
            seed: of the sensor noise.
            disturb_at_once: start the disturbance in cycle 0 instead of after the first command that opens the valve.
            disturb_after: time from that command to the start of the disturbance [s].
            log: records the true signals.
        """
        self.faults = Faults(calibration.wired)
        self.log = log
        self._simulator = simulator
        self._disturbance = disturbance
        self._calibration = calibration
        self._wired = np.array([EVERY_SENSED.index(signal) for signal in calibration.wired])
        self._values = [0.0] * (1 + max(used.channel for used in calibration.inputs))
        self._random = np.random.default_rng(seed)
        self._noise = np.empty((0, simulator.truth.size))
        self._drawn = 0
        self._null = converted(calibration.output.offset, calibration.output)
        self._disturbed = 0
        self._rows: list[list[float]] = []
        first = disturbance.rows(0, 1)[0]
        first[[FORCE_RATE, VELOCITY]] = 0.0
        self._row: list[float] = first.tolist()
        self._opened = disturb_at_once
        self._until_disturbed = 0 if disturb_at_once else round(disturb_after / simulator.period)

    @property
    def period(self) -> float:
        """Time between two cycles [s]."""
        return self._simulator.period

    @property
    def cycle(self) -> int:
        """Number of the current cycle."""
        return self._simulator.cycle

    def sense(self) -> tuple[float, ...]:
        """Return the raw values of the current cycle by channel number; a channel without a sensor reads 0."""
        if self._drawn == len(self._noise):
            self._noise, self._drawn = self._random.standard_normal((BLOCK, self._simulator.truth.size)), 0
        signals = self._simulator.measure(self._noise[self._drawn])[self._wired].tolist()
        self._drawn += 1
        self.faults.spoil(signals)
        for signal, channel in zip(signals, self._calibration.inputs, strict=True):
            raw = signal / channel.scale + channel.offset
            # A converter cannot produce NaN, but a target that computes its signals could send it.
            self._values[channel.channel] = converted(raw, channel) if raw == raw else raw  # noqa: PLR0124
        return tuple(self._values)

    def advance(self, raw: float, status: Status, sequence: int, answered: int, now: float) -> None:
        """Advance by one cycle, after :meth:`sense`.

        Args:
            raw: raw valve command, held over the cycle.
            status: reason why the command is at null, for the log.
            sequence: number of the last command accepted, for the log.
            answered: number of the measurement that it answers, for the log.
            now: time of this computer, for the log [s].
        """
        simulator, output = self._simulator, self._calibration.output
        raw = converted(raw, output)
        spool = output.scale * (raw - output.offset)
        self._opened |= raw != self._null
        if self._opened:
            if self._until_disturbed <= 0:
                at = self._disturbed % BLOCK
                if at == 0:
                    self._rows = self._disturbance.rows(self._disturbed, BLOCK).tolist()
                self._row = self._rows[at]
                self._disturbed += 1
            self._until_disturbed -= 1
        if self.log is not None:
            self.log.add((*self._truth(spool), raw, status, sequence, answered, now))
        simulator.advance(spool, *self._row)

    def _truth(self, spool: float) -> tuple[float, ...]:
        *truth, oil_temperature = self._simulator.truth[LOGGED].tolist()
        force, _, *motion = self._row
        if self._simulator.servo.size:
            motion = self._simulator.servo[[X, V]].tolist()
        time = self._simulator.cycle * self._simulator.period
        return (time, spool, *truth, force, oil_temperature, *motion)
