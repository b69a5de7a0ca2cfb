"""Process of a foreign FMU: ``python -m ehls_ros.fmu.plant_process READ WRITE PARENT``.

:mod:`ehls_ros.fmu.foreign_plant` starts it. It reads requests from one pipe and answers on another: lines of JSON in the
preparation, rows of doubles in the steps. A foreign library may crash, hang, or print anything; only this process is affected.
"""

import faulthandler
import json
import os
import resource
import struct
import sys
import zipfile
from collections.abc import Sequence
from typing import Any, BinaryIO

from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu

from ehls_ros.process import end_with

LARGEST = 2**31
"""Largest size of an unpacked FMU [bytes]."""

MEMORY = 8 * 2**30
"""Largest address space of the process [bytes]."""

VERSIONS = ("2.0", "3.0")


class Refused(Exception):
    """An FMU that cannot be run."""


def opened(path: str, unpacked: str) -> Any:
    """Unpack an FMU and return its model description.

    Raises:
        Refused: it is no FMU of a version and type that can be run.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size <= LARGEST:
            extract(path, unpacked)
            # The description is checked against the schema of its version.
            described = read_model_description(unpacked, validate=True)
    except Exception as error:  # noqa: BLE001 - parsers of a damaged file raise anything
        raise Refused(" ".join(str(error).split()) or type(error).__name__) from None
    if size > LARGEST:
        raise Refused(f"it unpacks to more than {LARGEST // 2**20} MiB")
    if described.fmiVersion not in VERSIONS:
        raise Refused(f"it is of FMI {described.fmiVersion}; expected {' or '.join(VERSIONS)}")
    if described.coSimulation is None:
        raise Refused("it has no Co-Simulation")
    return described


def unit_of(variable: Any) -> str:
    """Return the unit of a variable, from itself or its type; empty if it has none."""
    own, declared = variable.unit, getattr(variable, "declaredType", None)
    return own or getattr(declared, "unit", None) or ""


class Instance:
    """The running FMU.

    Attributes:
        time: time of the last communication point [s].
    """

    def __init__(self, described: Any, unpacked: str, request: dict[str, Any]) -> None:
        """Instantiate and initialise it."""
        self._fmu = instantiate_fmu(unpacked, described, "CoSimulation")
        third = described.fmiVersion == "3.0"
        self._set = self._fmu.setFloat64 if third else self._fmu.setReal
        self._get = self._fmu.getFloat64 if third else self._fmu.getReal
        self._inputs, self._outputs = request["inputs"], request["outputs"]
        self._period = request["period"]
        self.time = 0.0
        if not third:
            self._fmu.setupExperiment(startTime=0.0)
        parameters = {int(reference): value for reference, value in request["parameters"].items()}
        if parameters:
            self._set(list(parameters), list(parameters.values()))
        self._fmu.enterInitializationMode()
        self._write(request["first"])
        self._fmu.exitInitializationMode()

    def _write(self, values: Sequence[float]) -> None:
        if values:
            self._set(self._inputs, list(values))

    def read(self) -> list[float]:
        """Return the outputs."""
        return list(self._get(self._outputs))

    def step(self, values: Sequence[float]) -> list[float]:
        """Set the inputs, step over one period and return the outputs."""
        self._write(values)
        self._fmu.doStep(self.time, self._period)
        self.time += self._period
        return self.read()


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Serve one FMU until the pipe closes."""
    first = json.loads(requests.readline())
    # The library may write to its working folder.
    os.chdir(first["folder"])
    try:
        described = opened(first["path"], first["folder"])
        variables = [
            {"name": v.name, "reference": v.valueReference, "causality": v.causality, "unit": unit_of(v), "kind": v.type}
            for v in described.modelVariables
            if not getattr(v, "dimensions", None)
        ]
        _answer(answers, {"version": described.fmiVersion, "name": described.modelName, "variables": variables})
        request = json.loads(requests.readline() or "null")
        if request is None:
            return
        instance = Instance(described, first["folder"], request)
        outputs = instance.read()
    except Exception as error:  # noqa: BLE001 - FMPy raises many types
        _answer(answers, {"error": " ".join(str(error).split()) or type(error).__name__})
        return
    _answer(answers, {"outputs": outputs})
    row, made = struct.Struct(f"{len(request['inputs'])}d"), struct.Struct(f"{len(outputs)}d")
    while len(data := requests.read(row.size)) == row.size:
        try:
            outputs = instance.step(row.unpack(data))
        except Exception as error:  # noqa: BLE001 - FMPy raises many types
            sys.exit(str(error))  # after the FMU's own message
        answers.write(made.pack(*outputs))
        answers.flush()


def _answer(answers: BinaryIO, content: Any) -> None:
    answers.write(json.dumps(content).encode() + b"\n")
    answers.flush()


def main() -> None:
    """Serve the FMU that the parent names."""
    read, write, parent = map(int, sys.argv[1:])
    end_with(parent)
    faulthandler.disable()  # FMPy enables it; its report would hide the library's last message
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with os.fdopen(read, "rb") as requests, os.fdopen(write, "wb") as answers:
        serve(requests, answers)


if __name__ == "__main__":
    main()
