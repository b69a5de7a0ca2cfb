"""National Instruments cards through NI-DAQmx and its Python package `nidaqmx` (the extra ``nidaqmx``).

Never exercised on hardware: tested against a stand-in with the package's functions. The card's clock times the samples; the
output is written immediately, on this computer's timing. A card keeps its last voltage when this process dies: if the device
has a watchdog for analog outputs, set it up in NI-DAQmx.
"""

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.extras import library
from ehls_ros.hardware.backends.base import Reading, Wiring, permitted
from ehls_ros.hardware.sample_clock import free_running_time
from ehls_ros.schema import quantity, text

NOT_YET = -200284
"""NI-DAQmx's error code for a read timeout."""

MAX_AT_ONCE = 100
"""Maximum number of samples read from the card's buffer at once."""


class Parameters(NamedTuple):
    """The card, its input terminals and its buffer."""

    device: Annotated[str, text("name of the device in NI-DAQmx")] = "Dev1"
    terminals: Annotated[str, text("terminal configuration of the inputs: DEFAULT, RSE, NRSE, DIFF or PSEUDO_DIFF")] = "DEFAULT"
    buffer: Annotated[int, quantity("1", "length of the sample buffer", minimum=10, maximum=1_000_000)] = 1000


def load_package() -> Any:
    """Return the package.

    Raises:
        BadInput: it is not installed.
    """
    for part in ("constants", "errors", "stream_readers"):
        library(f"nidaqmx.{part}", "nidaqmx", "backend: nidaqmx")
    return library("nidaqmx", "nidaqmx", "backend: nidaqmx")


class NidaqmxDevice:
    """A card as a device: one task for the inputs, one for the output."""

    def __init__(self, parameters: Parameters, wiring: Wiring, period: float) -> None:
        """Set the tasks up, close the valve and start sampling."""
        package = load_package()
        constants = package.constants
        known = [terminals.name for terminals in constants.TerminalConfiguration]
        if parameters.terminals not in known:
            raise BadInput(f"terminals is {parameters.terminals!r}", "backend: nidaqmx", f"one of {', '.join(known)}")
        self._error = package.errors.DaqError
        self._wiring = wiring
        self._one = np.zeros(len(wiring.inputs))
        self._figures = {"read": 0, "skipped": 0, "written": 0}
        self._sequence = -1
        self._tasks: list[Any] = []
        try:
            self._inputs, self._output = (self._task(package) for _ in range(2))
            number, (low, high) = wiring.output
            self._output.ao_channels.add_ao_voltage_chan(f"{parameters.device}/ao{number}", min_val=low, max_val=high)
            self._output.write(wiring.null, auto_start=True)
            for number, (low, high) in wiring.inputs:
                self._inputs.ai_channels.add_ai_voltage_chan(
                    f"{parameters.device}/ai{number}",
                    terminal_config=constants.TerminalConfiguration[parameters.terminals],
                    min_val=low,
                    max_val=high,
                )
            self._inputs.timing.cfg_samp_clk_timing(
                1.0 / period, sample_mode=constants.AcquisitionType.CONTINUOUS, samps_per_chan=parameters.buffer
            )
            self._reader = package.stream_readers.AnalogMultiChannelReader(self._inputs.in_stream)
            self._inputs.start()
        except self._error as error:
            self._close_tasks()
            raise WorkFailed(f"{parameters.device} cannot be set up ({_first_line(error)})") from error
        self._epoch = free_running_time()

    def read(self, timeout: float) -> Reading | None:
        """Wait for the card's next sample; see :class:`~ehls_ros.hardware.backends.base.Device`."""
        try:
            self._reader.read_one_sample(self._one, timeout)
            taken, newest = 1, self._one
            while (waiting := min(self._inputs.in_stream.avail_samp_per_chan, MAX_AT_ONCE)) > 0:
                some = np.empty((len(self._one), waiting))  # the reader requires an array of exactly this size
                self._reader.read_many_sample(some, waiting, timeout)
                taken, newest = taken + waiting, some[:, -1]
        except self._error as error:
            if error.error_code == NOT_YET:
                return None
            raise WorkFailed(f"the inputs cannot be read ({_first_line(error)})") from error
        self._figures["read"] += 1
        self._figures["skipped"] += taken - 1
        self._sequence += taken
        return Reading(self._sequence, round(1e9 * (free_running_time() - self._epoch)), tuple(newest.tolist()))

    def write(self, value: float, sequence: int) -> None:
        """Set the output; see :class:`~ehls_ros.hardware.backends.base.Device`."""
        try:
            self._output.write(permitted(value, self._wiring))
        except self._error as error:
            raise WorkFailed(f"the output cannot be written ({_first_line(error)})") from error
        self._figures["written"] += 1

    def close(self) -> None:
        """Set the output to null and close the tasks."""
        if self._tasks:
            try:
                self.write(self._wiring.null, self._sequence)
            finally:
                self._close_tasks()

    def figures(self) -> Mapping[str, int]:
        """Return counts: samples read, samples skipped in favour of newer ones, outputs written."""
        return dict(self._figures)

    def _task(self, package: Any) -> Any:
        task = package.Task()
        self._tasks.append(task)
        return task

    def _close_tasks(self) -> None:
        while self._tasks:
            self._tasks.pop().close()


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


def open(parameters: Parameters, wiring: Wiring, period: float) -> NidaqmxDevice:  # noqa: A001
    """Set up the card's tasks with the valve closed.

    Raises:
        BadInput: the package is not installed, or a parameter is wrong.
        WorkFailed: NI-DAQmx refuses the device, a channel or a range.
    """
    return NidaqmxDevice(parameters, wiring, period)
