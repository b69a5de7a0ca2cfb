"""An emulated rig as a device of this process, in lockstep: it waits for the answer to each sample."""

from collections.abc import Mapping

from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.experiments.loop import sampled, simulator_of
from ehls_ros.experiments.spec import Spec
from ehls_ros.hardware.backends.base import Reading
from ehls_ros.hardware.calibration import Calibration
from ehls_ros.hardware.emulator import Emulator
from ehls_ros.hardware.packet import Status


class EmulatedDevice:
    """An emulator as a device; a command acts in the cycle after its sample, as over a wire.

    Attributes:
        emulator: the emulated rig.
    """

    def __init__(self, spec: Spec, calibration: Calibration) -> None:
        """Start the rig of an experiment at rest.

        Args:
            spec: the experiment, for its rig, disturbance, period and seed.
            calibration: of the channels.
        """
        kind, period = DISTURBANCES.load(spec.disturbance.name), spec.settings.control_period
        signal = sampled(spec.disturbance.signal, period)
        source = kind.build(spec.disturbance.parameters, signal, spec.rig, period)
        self.emulator = Emulator(simulator_of(spec), source, calibration, spec.settings.seed)
        self._calibration, self._acting = calibration, calibration.output.offset

    def read(self, timeout: float) -> Reading:
        """Return the next sample at once."""
        cycle = self.emulator.cycle
        values = self.emulator.sense()
        wired = tuple(values[channel.channel] for channel in self._calibration.inputs)
        return Reading(cycle, round(1e9 * cycle * self.emulator.period), wired)

    def write(self, value: float, sequence: int) -> None:
        """Advance by a cycle under the previous command, and keep this one for the next."""
        self.emulator.advance(self._acting, Status.COMMANDED, sequence, sequence, 0.0)
        self._acting = value

    def close(self) -> None:
        """Do nothing."""

    def figures(self) -> Mapping[str, int]:
        """Return nothing."""
        return {}
