"""`hardware_bridge_node`: the real rig in the graph. The DAQ's samples pace the cycles; the gate answers each of them."""

import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.files import config_folder
from ehls_ros.hardware.backends.base import Device, Reading
from ehls_ros.hardware.bridge_file import Bridge, bridge_from_mapping
from ehls_ros.hardware.calibration import Calibration
from ehls_ros.hardware.pace import ADVICE, MIN_ANSWERED, Pace
from ehls_ros.hardware.safety_gate import DISABLED
from ehls_ros.hardware.sample_clock import SampleClock, free_running_time
from ehls_ros.hardware.sample_decoder import SampleDecoder
from ehls_ros.nodes.diagnostics import ERROR, OK, WARN
from ehls_ros.nodes.parameters import declare
from ehls_ros.nodes.plant import PlantNode
from ehls_ros.nodes.running import run_node
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import quantity, text

LOCKSTEP_PATIENCE = 0.1
"""Wait for a sample or an answer in lockstep after which the gate's time advances anyway; a busy machine needs less [s]."""

SILENCE = 2.0
"""Periods without a sample after which the gate is stepped anyway."""

OTHER_RATE = 0.25
"""Relative deviation of the sample rate from the control rate at which the two do not match."""


class Parameters(NamedTuple):
    """Parameters of the bridge."""

    bridge: Annotated[str, text("bridge file: DAQ backend, channels, calibration; empty: UDP to this host")] = ""
    answer_time: Annotated[
        float,
        quantity("1", "fraction of the period a cycle waits for its answer", above=0.0, maximum=1.0),
    ] = 0.8
    least_answered: Annotated[
        float,
        quantity("1", "fraction of the samples that must be answered before the gate opens", minimum=0.0, maximum=1.0),
    ] = MIN_ANSWERED


class HardwareBridgeNode(PlantNode):
    """Passes samples to the graph and commands through the gate to the rig. The valve stays closed until `enable`.

    Attributes:
        opened: whether the device was ever opened.
    """

    def __init__(self) -> None:
        """Declare the parameters and read the bridge file.

        Raises:
            BadInput: the bridge file is wrong.
        """
        super().__init__("hardware_bridge_node")
        fraction = float(self.get_parameter("answer_time").value)
        self.answer_time = LOCKSTEP_PATIENCE if self.lockstep else fraction * self.period
        self.sample_time = LOCKSTEP_PATIENCE if self.lockstep else SILENCE * self.period
        self.bridge: Bridge
        self.calibration: Calibration
        self.decoder: SampleDecoder
        self.opened = False
        # First cycle of the run: the first one answered, or before that, the one that the loop began with.
        self.first = 0
        self.has_answers = False
        self.in_time = 0
        # Made by `prepare`:
        self.device: Device
        self.samples: SampleClock
        self.pace: Pace
        self.cycle: int
        self.sequence: int
        self.session: int
        self.saturated: tuple[str, ...]
        self.at_null: bool
        self.restarts: int
        self.failure: str
        self.elapsed: int
        self.lockstep_time: float

    def measured(self) -> Collection[str]:
        """Read the bridge file and return the signals that are known."""
        declare(self, Parameters, live=False)
        chosen = self.text_parameter("bridge")
        path = Path(chosen) if chosen else config_folder() / "bridge_udp.yaml"
        self.bridge = bridge_from_mapping(read_yaml(path, "bridge file"), str(path))
        self.calibration = self.bridge.calibration
        self.decoder = SampleDecoder(self.calibration, self.spec.rig)
        return self.decoder.measured

    def prepare(self) -> None:
        """Open the device and the topics."""
        try:
            self.device = self.bridge.open(self.period)
        except WorkFailed as error:
            raise BadInput(str(error), self.get_name(), "a device that is connected and free") from None
        self.opened = True
        self.open_topics()
        self.samples = SampleClock(self.period)
        self.cycle = -1
        self.sequence = -1
        self.session = 0
        self.saturated = ()
        self.at_null = True
        self.restarts = 0
        self.failure = ""
        self.elapsed = 1
        self.lockstep_time = 0.0
        self._reset_counts()

    def release(self) -> None:
        """Close the valve, the device and the topics."""
        self.device.close()
        super().release()

    def secure(self) -> None:
        """Close the valve and the device, if it was opened."""
        if self.opened:
            self.device.close()

    def start(self) -> None:
        """Begin with the next sample, disabled."""
        self.first, self.has_answers = self.cycle + 1, False
        self.begin_stamps(self.first)
        self._reset_counts()
        self.gate.begin()

    def stop(self) -> None:
        """Close the valve."""
        self.gate.leave()
        self._write(0.0)
        # The service thread waits for the end of the loop, and that for the readers of its announcement.
        self.report_gate()

    def once(self) -> None:
        """Take one sample and answer it, or handle its absence."""
        try:
            reading = self.device.read(self.sample_time)
            self.failure = ""
        except WorkFailed as error:
            self.failure = str(error)
            reading = None
        if reading is None:
            self._step_without_sample()
            return
        self._open_cycle(reading)
        deadline = time.perf_counter() + self.answer_time
        self.take_commands(self.cycle)
        while self.answered != self.cycle and (remaining := deadline - time.perf_counter()) > 0.0:
            self.answer.wait(remaining)
            self.take_commands(self.cycle)
        if self.answered >= self.first:
            if not self.has_answers:
                self.first, self.has_answers = self.answered, True
            in_time = self.answered == self.cycle
            self.in_time += in_time
            # Lost samples count as unanswered.
            self.statistics.missed += self.elapsed - in_time
            self._check_pace()
        self._write(self.gate.step(self._time()))
        self.publish_telemetry()
        if self.have_all_run(self.cycle - self.first + 1, self.elapsed):
            self.end_cycles()

    def _reset_counts(self) -> None:
        self.pace = Pace(float(self.get_parameter("least_answered").value))
        self.in_time = 0

    def _check_pace(self) -> None:
        """Check whether samples are answered as fast as they arrive."""
        before = self.pace.complaint
        ended = not self.lockstep and self.pace.look(time.perf_counter(), self.cycle - self.first + 1, self.in_time)
        if ended and self.pace.complaint != before:
            self.report_change()

    def refusal(self) -> str | None:
        """Return why the gate must stay closed: this computer or the controller is too slow; None if it may open."""
        if self.lockstep:
            return self._other_rate() or None
        if self.samples.rate == 0.0 or (self.pace.asked == 0.0 and not self.pace.complaint):
            return "no fresh command: the rate of answers is still being measured"
        return self._other_rate() or (f"{self.pace.complaint}: {ADVICE}" if self.pace.complaint else None)

    def _other_rate(self) -> str:
        """Return the mismatch of the device's rate, for which the law is not designed; empty if the rates agree."""
        # By the device's clock: a device emulated on a busy computer has fewer samples a second, but of the right period.
        rate = self.samples.rate
        if rate == 0.0 or abs(rate * self.period - 1.0) <= OTHER_RATE:
            return ""
        wanted = f"control_period {self.period:g} s means {1.0 / self.period:.0f}"
        return f"the device samples {rate:.0f} times a second, {wanted}: set one of them to the other's"

    def _clock_drift(self) -> str:
        """Return the rate difference between the device's clock and the arrival of its samples; empty if they agree."""
        drift = self.samples.drift
        if self.lockstep or not self.samples.strays:
            return ""
        if drift > 0.0:
            return f"samples arrive later by {1e3 * drift:.2g} ms each second: the delay grows, or the device's clock loses"
        return f"the device's clock gains {-1e3 * drift:.2g} ms each second: a delay that grows would not show"

    def _time(self) -> float:
        """Return the gate's time [s]: wall-clock time, or cycle time in lockstep, where the device waits."""
        if not self.lockstep:
            return free_running_time()
        self.lockstep_time += self.elapsed * self.period
        return self.lockstep_time

    def _open_cycle(self, reading: Reading) -> None:
        """Number and publish the sample; lost samples count as cycles, so that the cycles keep the device's time."""
        following = self.sequence >= 0 and reading.sequence > self.sequence and reading.session == self.session
        self.restarts += self.sequence >= 0 and not following
        self.elapsed = reading.sequence - self.sequence if following else 1
        self.cycle += self.elapsed
        self.sequence, self.session = reading.sequence, reading.session
        self.at_null = reading.at_null
        signals, self.saturated = self.decoder.decode(reading.values)
        self.samples.take(reading.sequence, reading.time_ns, free_running_time(), reading.session)
        # In lockstep the device waits for this computer.
        lag = 0.0 if self.lockstep else self.samples.lag
        self.publish(self.cycle, signals, elapsed=self.samples.elapsed, lag=lag, at_null=reading.at_null)

    def _step_without_sample(self) -> None:
        """Step the gate, which detects stale snapshots, and keep sending its command to the device."""
        self.elapsed = 1
        self.take_commands(self.cycle)
        self._write(self.gate.step(self._time()))

    def _write(self, spool: float) -> None:
        try:
            self.device.write(self.calibration.command(spool), self.sequence)
        except WorkFailed as error:
            self.failure = str(error)
        self.announcements.publish_driving(driving=self.gate.driving, in_full=self.gate.in_full)

    def figures(self) -> dict[str, Any]:
        """Return figures for diagnostics."""
        counted = {f"device_{name}": count for name, count in self.device.figures().items()}
        own = {"cycle": self.cycle, "device_began_anew": self.restarts, "device_at_null": self.at_null}
        clock = {"sample_lag_s": self.samples.lag, "device_clock_drift_ppm": -1e6 * self.samples.drift}
        pace = self.pace.figures() if self.is_active else {}
        return {**super().figures(), **own, **clock, **counted, **pace}

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the state of device, gate and cycles."""
        level, message, figures = super().health()
        if self.failure:
            return ERROR, self.failure, figures
        if level == OK and self.at_null and self.gate.state != DISABLED:
            return WARN, "the device keeps the valve closed: commands do not reach it", figures
        if level != ERROR and self.is_active:
            slow = f"{self.pace.complaint}: {ADVICE}" if self.pace.complaint else ""
            wrong = self._other_rate() or slow or self._clock_drift()
            if wrong:
                return WARN, wrong, figures
        if level == OK and self.saturated:
            return WARN, f"converter at the end of its range: {', '.join(self.saturated)}", figures
        return level, message, figures


def main() -> NoReturn:
    """Run the node."""
    run_node(HardwareBridgeNode)


if __name__ == "__main__":
    main()
