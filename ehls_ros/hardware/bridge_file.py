"""The bridge file: DAQ backend, channels and their calibration."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput, one_of
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.backends.base import Device
from ehls_ros.hardware.calibration import Calibration, Input, Output, check_channel
from ehls_ros.physics.rig import EVERY_SENSED
from ehls_ros.schema import parse

SECTIONS = ("backend", "channels", "command")


class Bridge(NamedTuple):
    """The backend, its parameters and the calibration of the channels."""

    backend: str
    parameters: Any
    calibration: Calibration

    def open(self, period: float) -> Device:
        """Open the device; ``period`` is the sampling period [s].

        Raises:
            BadInput: a parameter or channel does not fit the device.
            WorkFailed: the device cannot be opened.
        """
        return BACKENDS.load(self.backend).open(self.parameters, self.calibration.wiring, period)


def bridge_from_mapping(data: Any, where: str) -> Bridge:
    """Check a parsed bridge file.

    Args:
        data: a mapping with the sections of :data:`SECTIONS`.
        where: the file, for errors.

    Raises:
        BadInput: a key is missing, unknown or out of range; the first one is named.
    """
    if not isinstance(data, Mapping):
        raise BadInput(f"it contains a {type(data).__name__}", where, f"a mapping with the sections {', '.join(SECTIONS)}")
    for section in data:
        if section not in SECTIONS:
            raise BadInput(f"section {section!r} is unknown", where, one_of(section, SECTIONS))
    for section in SECTIONS:
        if section not in data:
            raise BadInput(f"section '{section}' is missing", where, "a mapping of its keys")
        if not isinstance(data[section], Mapping):
            raise BadInput(f"section '{section}' is {data[section]!r}", where, "a mapping of its keys")
    values = dict(data["backend"])
    place = f"{where}: backend"
    if "name" not in values:
        raise BadInput("key 'name' is missing", place, f"one of {', '.join(BACKENDS.names())}")
    name = values.pop("name")
    backend = BACKENDS.load(name, place)
    output = parse(Output, data["command"], f"{where}: command")
    check_channel(output, f"{where}: command")
    inputs = _inputs(data["channels"], f"{where}: channels")
    return Bridge(name, parse(backend.Parameters, values, f"{place}: {name}"), Calibration(inputs, output))


def _inputs(data: Mapping[str, Any], where: str) -> dict[str, Input]:
    inputs: dict[str, Input] = {}
    taken: dict[int, str] = {}
    for signal, values in data.items():
        if signal not in EVERY_SENSED:
            raise BadInput(f"signal {signal!r} is unknown", where, one_of(signal, EVERY_SENSED))
        place = f"{where}: {signal}"
        if not isinstance(values, Mapping):
            raise BadInput(f"{signal} is {values!r}", where, f"a mapping of {', '.join(Input._fields)}")
        inputs[signal] = parse(Input, values, place)
        check_channel(inputs[signal], place)
        other = taken.setdefault(inputs[signal].channel, signal)
        if other != signal:
            raise BadInput(f"channel is {inputs[signal].channel}, already used by {other}", place, "a separate channel")
    if not inputs:
        raise BadInput("no signal is wired", where, f"at least one of {', '.join(EVERY_SENSED)}")
    return inputs
