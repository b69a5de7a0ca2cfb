"""A plant that another program made: an FMU in a process of its own, in place of the simulator."""

import json
import math
import os
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.fmu.library import headers
from ehls_ros.fmu.plant_map import CHAMBERS, INPUT_UNITS, Described, PlantMap, Wiring, wired
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.plausibility import implausible
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.physics.simulator import OIL_TEMPERATURE

PREPARATION = 60.0
"""Longest time for loading and initialising an FMU [s]."""

ANSWER = 5.0
"""Longest time for a step [s]."""


class FmuProcess:
    """The process that runs the FMU, and the pipes to it."""

    def __init__(self, path: Path) -> None:
        """Start the process.

        Args:
            path: the FMU.
        """
        self._path = path
        self._folder = tempfile.mkdtemp(prefix="ehls_plant_fmu_")
        self._output: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        to_read, self._to = os.pipe()
        self._from, to_write = os.pipe()
        try:
            words = [sys.executable, "-m", "ehls_ros.fmu.plant_process", str(to_read), str(to_write), str(os.getpid())]
            self._process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=self._output, stderr=self._output, pass_fds=(to_read, to_write)
            )
        finally:
            os.close(to_read)
            os.close(to_write)
        self._read = b""

    def open(self) -> Any:
        """Open the FMU and return its description.

        Raises:
            WorkFailed: the process died or did not answer in time.
            BadInput: it refuses the FMU.
        """
        return self.line({"path": str(self._path.resolve()), "folder": self._folder})

    def line(self, request: Mapping[str, Any]) -> Any:
        """Send a line of JSON and return the answer.

        Raises:
            WorkFailed: the process died or did not answer in time.
            BadInput: it refuses the FMU.
        """
        self._send(json.dumps(request).encode() + b"\n")
        until = time.monotonic() + PREPARATION
        while b"\n" not in self._read:
            self._receive(until)
        text, _, self._read = self._read.partition(b"\n")
        answer = json.loads(text)
        if "error" in answer:
            raise BadInput(f"{answer['error']}{self._said()}", str(self._path), "an FMU for Co-Simulation, of FMI 2.0 or 3.0")
        return answer

    def row(self, data: bytes, size: int) -> bytes:
        """Send a row and return the answer of a size.

        Raises:
            WorkFailed: the process died or did not answer in time.
        """
        self._send(data)
        until = time.monotonic() + ANSWER
        while len(self._read) < size:
            self._receive(until)
        answer, self._read = self._read[:size], self._read[size:]
        return answer

    def close(self) -> None:
        """End the process."""
        if self._to >= 0:
            os.close(self._to)
            os.close(self._from)
            self._to = self._from = -1
            try:
                self._process.wait(1.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._output.close()
            # A process that was killed cannot remove what it unpacked.
            shutil.rmtree(self._folder, ignore_errors=True)

    def _send(self, data: bytes) -> None:
        if self._to < 0:
            raise WorkFailed(f"{self._path}: the FMU's process has ended")
        try:
            os.write(self._to, data)
        except BrokenPipeError:
            raise self._lost() from None

    def _receive(self, until: float) -> None:
        left = until - time.monotonic()
        if left <= 0.0 or not select.select((self._from,), (), (), left)[0]:
            self._process.kill()
            self._process.wait()
            raise WorkFailed(f"{self._path}: the FMU did not answer in time and was ended{self._said()}")
        data = os.read(self._from, 65536)
        if not data:
            raise self._lost()
        self._read += data

    def _lost(self) -> WorkFailed:
        code = self._process.wait()
        cause = f"by signal {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
        return WorkFailed(f"{self._path}: the FMU's process ended {cause}{self._said()}")

    def _said(self) -> str:
        """Return the last lines that the process printed."""
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").strip().splitlines()
        return f" ({'; '.join(line.strip()[:200] for line in lines[-2:])})" if lines else ""


class ForeignPlant:
    """An FMU with the interface of :class:`~ehls_ros.physics.simulator.Simulator`.

    Once the FMU is lost, readings are NaN, on which the safety gate closes the valve, and :meth:`trouble` gives the reason.

    Attributes:
        rig: the rig file that describes it.
        period: control period [s].
        truth: readings, in the order of ``rig.sensed``; NaN for the pressure of a chamber that the FMU lacks.
        acting: disturbance of the last period.
        servo: empty: the actuator under test is an input.
        cycle: number of control periods completed.
        version: version of FMI.
    """

    def __init__(
        self,
        path: Path,
        plant_map: PlantMap,
        rig: Rig,
        period: float,
        position: float = 0.0,
        temperature: float = OIL_TEMPERATURE,
        warming: float = 0.0,
    ) -> None:
        """Load and initialise the FMU.

        Args:
            path: the FMU.
            plant_map: its variables.
            rig: rig file that describes it.
            period: control period [s].
            position: initial position of an exported rig [m].
            temperature: initial oil temperature [K].
            warming: rate of the oil temperature [K/s].

        Raises:
            BadInput: the file is no FMU, its variables do not fit, or FMPy is not installed.
            WorkFailed: the FMU crashed or hung.
        """
        headers(str(path))
        if not path.is_file():
            raise BadInput("there is no such file", str(path), "an FMU")
        self.rig, self.period = rig, period
        self.cycle = 0
        self.acting = np.zeros(4)
        self.servo = np.zeros(0)
        self.lost = ""
        self._noise_std = np.array([rig.sensors.get(signal, Sensor()).noise_std for signal in rig.sensed])
        self._warming, self._temperature = warming, temperature
        self._process = FmuProcess(path)
        try:
            answer = self._process.open()
            self.version = str(answer["version"])
            variables = {entry["name"]: Described(**entry) for entry in answer["variables"]}
            self._wiring: Wiring = wired(variables, plant_map, str(path), {"initial_position": position}, rig.sensed)
            minus = [link.minus for link in self._wiring.outputs if link.minus is not None]
            outputs = [*(link.reference for link in self._wiring.outputs), *minus]
            request = {
                "inputs": [link.reference for link in self._wiring.inputs],
                "outputs": outputs,
                "parameters": {str(reference): value for reference, value in self._wiring.parameters.items()},
                "period": period,
                "first": self._row(0.0),
            }
            self._in, self._out = struct.Struct(f"{len(self._wiring.inputs)}d"), struct.Struct(f"{len(outputs)}d")
            first = self._process.line(request)["outputs"]
        except BaseException:
            self._process.close()
            raise
        lacking = CHAMBERS - {link.signal for link in self._wiring.outputs}
        self._has_chambers = not lacking
        self._read = np.array([signal not in lacking for signal in rig.sensed])
        self.truth = self._readings(first)

    def _row(self, command: float) -> list[float]:
        """Return the inputs in the FMU's units."""
        values = dict(zip(INPUT_UNITS, [command, *self.acting, self._temperature], strict=True))
        return [(values[link.signal] - link.offset) / link.scale for link in self._wiring.inputs]

    def _readings(self, values: Sequence[float]) -> Array:
        """Return the readings in SI units; those that the FMU lacks follow from others and the rig file."""
        found, rest = dict[str, float](), iter(values[len(self._wiring.outputs) :])
        for link, value in zip(self._wiring.outputs, values, strict=False):
            less = 0.0 if link.minus is None else next(rest)
            found[link.signal] = link.scale * (value - less) + link.offset
        area, chambers = self.rig.plant.piston_area, self.rig.cylinder.parameters
        if self._has_chambers:
            driving = chambers.area_a * found["pressure_a"] - chambers.area_b * found["pressure_b"]
            found.setdefault("load_pressure", driving / area)
        found.setdefault("force", area * found.get("load_pressure", math.nan))
        found.setdefault("load_pressure", found["force"] / area)
        found.setdefault("supply_pressure", self.rig.plant.supply_pressure)
        found.setdefault("oil_temperature", self._temperature)
        return np.array([found.get(signal, math.nan) for signal in self.rig.sensed])

    def measure(self, noise: Array) -> Array:
        """Return the readings in the order of ``rig.sensed``, with the noise of the rig file's sensors.

        Args:
            noise: standard normal numbers, shape (signals,).
        """
        return self.truth + self._noise_std * noise

    def advance(self, command: float, force: float, force_rate: float, displacement: float, velocity: float) -> int:
        """Step the FMU over one period; the arguments are those of :meth:`ehls_ros.physics.simulator.Simulator.advance`."""
        self.acting[:] = force, force_rate, displacement, velocity
        self.cycle += 1
        if self.lost:
            return 0
        try:
            answer = self._process.row(self._in.pack(*self._row(command)), self._out.size)
        except WorkFailed as error:
            self._lose(str(error))
            return 0
        self._temperature += self._warming * self.period
        self.truth = self._readings(self._out.unpack(answer))
        lost = self._read & ~np.isfinite(self.truth)
        if lost.any():
            signals = [signal for signal, gone in zip(self.rig.sensed, lost, strict=True) if gone]
            self._lose(f"the FMU returned NaN or infinity for {', '.join(signals)}")
        return 0

    def _lose(self, reason: str) -> None:
        self.lost = f"{reason} (at {self.cycle * self.period:g} s)"
        self.truth = np.full(len(self.rig.sensed), math.nan)
        self._process.close()

    def trouble(self) -> str:
        """Return why the FMU was lost, or its impossible reading; empty if there is none."""
        if self.lost:
            return self.lost
        # Pressures of chambers have no limits, and may be lacking.
        found = implausible(self.truth[np.newaxis, : len(SENSED)], self.rig.limits)
        return "" if found is None else f"{found.what} (at {self.cycle * self.period:g} s)"

    def close(self) -> None:
        """End the FMU's process."""
        self._process.close()
