"""A rig driven in steps through its safety gate, without ROS: samples in, bounded commands out, everything recorded."""

import math
import time
from collections.abc import Callable

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import WorkFailed
from ehls_ros.hardware.backends.base import Device, Reading
from ehls_ros.hardware.calibration import Calibration, step
from ehls_ros.hardware.gate_bounds import bounds_of, within
from ehls_ros.hardware.gate_parameters import WARN
from ehls_ros.hardware.gate_parameters import Parameters as GateParameters
from ehls_ros.hardware.safety_gate import Gate, watched
from ehls_ros.hardware.sample_decoder import SampleDecoder
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.recording.topics import READINGS
from ehls_ros.trajectory import Trajectory

Law = Callable[[Array, int], float]
"""Spool command [m] from the readings in the order of a rig's ``sensed`` (NaN where not known) and the number of the cycle."""

TRIP_LEVEL = 0.6
"""Fraction of the rig's limits beyond which the gate closes the valve."""

ENABLE_TIME = 0.2
"""Time over which commands are blended in [s]."""

PATIENCE = 0.2
"""Longest wait for a sample [s]."""

MAX_SILENT = 10
"""Number of waits without a sample after which the device counts as lost."""

OPENING = 200
"""Number of cycles within which the gate must open."""

SENDER = "commission"


class Stopped(WorkFailed):
    """A step ended early: the gate closed the valve, or the device was lost.

    Attributes:
        recording: samples up to then.
    """

    def __init__(self, why: str, recording: Trajectory) -> None:
        """Keep the recording."""
        super().__init__(why)
        self.recording = recording


class Session:
    """An open device behind a gate.

    Attributes:
        wired: signals that have a channel.
        measured: signals that are known, from a channel or from others.
        period: sampling period [s].
    """

    def __init__(
        self,
        device: Device,
        calibration: Calibration,
        rig: Rig,
        period: float,
        *,
        lockstep: bool = False,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        """Take an open device, its valve closed.

        Args:
            device: the device.
            calibration: of its channels.
            rig: the rig, for its limits.
            period: sampling period [s].
            lockstep: whether the device waits for the answer to each sample.
            stopped: returns whether to stop; checked every cycle.
        """
        self.wired = calibration.wired
        self.period = period
        self._device, self._calibration, self._lockstep, self._stopped = device, calibration, lockstep, stopped
        self._decoder = SampleDecoder(calibration, rig)
        self.measured = self._decoder.measured
        chosen = tuned_for(GateParameters, rig)
        # The largest rate of a reading follows from numbers of the rig file, which are not known yet.
        chosen = chosen._replace(trip_level=min(chosen.trip_level, TRIP_LEVEL), enable_time=ENABLE_TIME, on_sensor_jump=WARN)
        self._usual = within(chosen, bounds_of(rig, period))
        self._gate = Gate(rig, period, self._usual, watched(self.measured))
        self._gate.begin()
        self._cycle = 0

    def resolution(self, signal: str) -> float:
        """Return the step of a signal's converter, in the signal's unit; 0 if it has no channel."""
        if signal not in self.wired:
            return 0.0
        channel = self._calibration.inputs[self.wired.index(signal)]
        return math.fabs(channel.scale) * step(channel)

    def record(self, law: Law | None, duration: float, *, presses: bool = False) -> Trajectory:
        """Drive the rig for a time, return the valve to null, and return the recording.

        Args:
            law: the command; None: the valve stays closed.
            duration: plant time [s].
            presses: whether the piston presses against an actuator that holds: it may move by less than a step of its sensor,
                as if that were frozen.

        Raises:
            Stopped: the gate closed the valve, no samples arrive, or a stop was requested.
        """
        cycles = round(duration / self.period)
        times, rows = np.zeros(cycles), np.full((cycles, len(self._decoder.sensed) + 1), np.nan)
        first, done, opening = None, 0, 0
        self._gate.retune(self._usual._replace(on_sensor_frozen=WARN) if presses else self._usual)
        try:
            while done < cycles:
                reading = self._next(times[:done], rows[:done])
                first = reading.time_ns if first is None else first
                signals = self._sense(reading)
                driving = law is not None and self._gate.driving
                wanted = law(np.asarray(signals), done) if law is not None and driving else 0.0
                passed = self._answer(reading, wanted, drive=law is not None)
                if law is not None and self._gate.causes:
                    why = f"the gate closed the valve: {self._gate.causes[0]}"
                    raise Stopped(why, self._recording(times[:done], rows[:done]))
                if law is not None and not driving:
                    opening += 1
                    if opening > OPENING:
                        why = f"the gate does not open: {self._gate.enable()}"
                        raise Stopped(why, self._recording(times[:done], rows[:done]))
                    continue
                times[done] = 1e-9 * (reading.time_ns - first)
                rows[done] = (*signals, passed)
                done += 1
        finally:
            self._close()
        return self._recording(times, rows)

    def _next(self, times: Array, rows: Array) -> Reading:
        for _ in range(MAX_SILENT):
            if self._stopped():
                raise Stopped("stopped on request", self._recording(times, rows))
            reading = self._device.read(PATIENCE)
            if reading is not None:
                self._cycle += 1
                return reading
            self._write(0.0, -1)
        raise Stopped("the device sends no samples", self._recording(times, rows))

    def _sense(self, reading: Reading) -> tuple[float, ...]:
        signals, _ = self._decoder.decode(reading.values)
        self._gate.sense(self._cycle, signals[: len(SENSED)], at_null=reading.at_null)
        return signals

    def _answer(self, reading: Reading, command: float, *, drive: bool) -> float:
        """Send a command through the gate and return what it passed [m]."""
        self._gate.take(self._cycle, command, SENDER)
        if drive and not self._gate.driving and not self._gate.causes:
            self._gate.enable()
        passed = self._gate.step(self._cycle * self.period if self._lockstep else time.monotonic())
        self._write(passed, reading.sequence)
        return passed

    def _close(self) -> None:
        """Ramp to null, and clear a trip so that the next step can begin."""
        self._gate.disable()
        for _ in range(OPENING):
            reading = self._device.read(PATIENCE)
            if reading is None:
                break
            self._cycle += 1
            self._sense(reading)
            self._answer(reading, 0.0, drive=False)
            if self._gate.output == 0.0 and self._gate.reset() is None and not self._gate.causes:
                break

    def _write(self, spool: float, sequence: int) -> None:
        self._device.write(self._calibration.command(spool), sequence)

    def _recording(self, times: Array, rows: Array) -> Trajectory:
        sensed = self._decoder.sensed
        signals = {READINGS[name]: rows[:, sensed.index(name)].copy() for name in self.measured}
        return Trajectory(times.copy(), {"valve_command_m": rows[:, -1].copy(), **signals})
