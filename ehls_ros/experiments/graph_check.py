"""Check that an experiment, a plant, a bridge and a law fit together, before any node starts.

Each check names the cause and the remedy. Without it, nodes would start and wait in silence, or the safety gate would trip.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.programme.declaration import Limits as ProgrammeLimits
from ehls_ros.control.programme.expansion import programme_of
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import Spec, check_law, check_spec, reference_extremes, signal_kind
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.bridge_file import Bridge, bridge_from_mapping
from ehls_ros.hardware.calibration import Input, Output
from ehls_ros.hardware.gate_bounds import bounds_of, within
from ehls_ros.hardware.gate_parameters import SIMULATED
from ehls_ros.hardware.gate_parameters import Parameters as GateParameters
from ehls_ros.hardware.safety_gate import Gate, watched
from ehls_ros.hardware.sample_decoder import measured_signals
from ehls_ros.physics.rig import SENSED
from ehls_ros.recording.yaml_text import read_yaml

UNITS = {"force": "N", "position": "m"}
"""Units of the quantities that a law may follow."""

MIN_REACH = 0.5
"""Smallest part of the spool's limit that the command channel must reach: a law that expects more winds up."""


class Graph(NamedTuple):
    """The part of a graph that an experiment does not determine.

    Attributes:
        law: controller; empty: the experiment's.
        bridge: the bridge to the rig; None: the simulated rig.
        lockstep: whether each cycle waits for its answer.
    """

    law: str = ""
    bridge: Bridge | None = None
    lockstep: bool = True


def bridge_at(file: Path | None) -> Bridge:
    """Read a bridge file.

    Args:
        file: its path; None: UDP to this host.

    Raises:
        BadInput: it cannot be read, or a key is wrong.
    """
    path = file or config_folder() / "bridge_udp.yaml"
    return bridge_from_mapping(read_yaml(path, "bridge file"), str(path))


def check_fit(spec: Spec, graph: Graph, where: str) -> tuple[str, ...]:
    """Check that the parts of a graph fit together.

    Args:
        spec: the experiment.
        graph: the rest.
        where: the experiment's file, for errors.

    Returns:
        Remarks for the user on parts of the experiment that this graph leaves to others.

    Raises:
        BadInput: they do not fit; the first cause is named, with the remedy.
    """
    law = graph.law or spec.controller.name
    check_law(spec, law, where)
    check_spec(spec, where)
    measured = SENSED if graph.bridge is None else _measured(spec, graph.bridge)
    # The gate itself refuses limits without which it cannot protect.
    Gate(spec.rig, spec.settings.control_period, None, measured, bounds={} if graph.bridge is None else None)
    for check in (
        _signals,
        _observer,
        _programme_signals,
        _companions,
        _timing,
        _period,
        _reference,
        _programme_limits,
        _range,
    ):
        for problem in check(spec, graph, law, where):
            raise problem
    return tuple(_remarks(spec, graph))


def laws_for(follows: str, measured: Sequence[str]) -> list[str]:
    """Return the laws that follow a quantity and need no other readings than those measured."""
    laws = CONTROLLERS.usable()
    return [name for name, law in laws.items() if follows == law.FOLLOWS and not _unmet(law, measured)]


def _measured(spec: Spec, bridge: Bridge) -> tuple[str, ...]:
    """Return the signals of every rig that a bridge knows."""
    return watched(measured_signals(spec.rig, bridge.calibration.wired))


def _unmet(law: object, measured: Sequence[str]) -> list[str]:
    """Return the readings that a law or its friction observer needs and that are not measured."""
    needs = dict.fromkeys(getattr(law, "NEEDS", ()))
    needs |= {"velocity": None} if getattr(law, "FRICTION", False) else {}
    return [signal for signal in needs if signal not in measured]


def _instead(spec: Spec, law: str, measured: Sequence[str], missing: Sequence[str]) -> str:
    """Return the remedies for missing readings: a channel for each, or a law that does without."""
    able = [name for name in laws_for(CONTROLLERS.load(law).FOLLOWS, measured) if name != law]
    other = f"controller {' or '.join(able)}; or " if able else ""
    return f"{other}a channel for {', '.join(missing)} in the bridge file"


def _signals(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    if graph.bridge is None:
        return
    measured = _measured(spec, graph.bridge)
    missing = [signal for signal in CONTROLLERS.load(law).NEEDS if signal not in measured]
    if missing:
        what = f"{law} needs {', '.join(missing)}, which the bridge does not measure"
        yield BadInput(what, where, _instead(spec, law, measured, missing))


def _observer(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    if graph.bridge is None or "velocity" in graph.bridge.calibration.wired or not CONTROLLERS.load(law).FRICTION:
        return
    what = (
        f"the friction observer {spec.compensation.name}, which {law} uses, needs velocity, which the bridge does not measure"
    )
    yield BadInput(what, where, _instead(spec, law, _measured(spec, graph.bridge), ["velocity"]))


def _programme_signals(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    """A programme counts and judges load cycles by the reading that it prescribes, and by the position if that is limited."""
    if graph.bridge is None or spec.reference.name != "programme":
        return
    wired, follows = graph.bridge.calibration.wired, CONTROLLERS.load(law).FOLLOWS
    if follows not in wired:
        yield BadInput(
            f"the programme's load cycles are judged by the {follows}, which the bridge does not measure",
            where,
            f"a channel for {follows} in the bridge file",
        )
    for name, limits in _limits(spec):
        if limits.of_position and "position" not in wired:
            what = f"block {name} limits position or stiffness, and the bridge does not measure the position"
            yield BadInput(
                what, where, "a channel for position in the bridge file; or no limit on position and stiffness_change"
            )


def _companions(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    """The setpoint of a real actuator is not in step with the cycles of the graph."""
    for use in spec.companions if graph.bridge is not None else ():
        if COMPANIONS.load(use.name).ACTUATOR:
            what = f"{use.name} needs the setpoint of the actuator under test cycle by cycle, which a bridge does not provide"
            yield BadInput(what, f"{where}: companions", f"no {use.name}, or the simulated rig")


def _timing(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    if graph.bridge is not None and graph.lockstep and not getattr(BACKENDS.load(graph.bridge.backend), "WAITS", False):
        what = f"backend {graph.bridge.backend} samples by its own clock and does not wait, as lockstep requires"
        yield BadInput(what, where, "timing realtime")


def _period(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    """Check that a cycle is shorter than the times after which gate and device take its command as stale."""
    period, gate = spec.settings.control_period, _gate_of(spec, graph)
    for name in ("command_timeout", "sensor_timeout"):
        timeout = getattr(gate, name)
        if period >= timeout:
            what = f"control_period is {period:g} s, and the safety gate's {name} is {timeout:g} s: it would close at once"
            yield BadInput(what, where, f"a control_period below {timeout:g} s")
    watchdog = math.inf if graph.bridge is None else getattr(graph.bridge.parameters, "watchdog", math.inf)
    if period >= watchdog:
        what = f"control_period is {period:g} s, and the device closes the valve {watchdog:g} s after a command"
        yield BadInput(what, where, f"a control_period below {watchdog:g} s, or a longer watchdog in the bridge file")


def _reference(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    follows = CONTROLLERS.load(law).FOLLOWS
    low, high = _trip_range(spec, graph, follows)
    values = [("the reference reaches", value) for value in reference_extremes(spec)]
    if spec.reference.name == "programme":
        hold = programme_of(spec.reference.parameters).parameters.hold
        values += [] if hold is None else [("the programme holds", hold)]
    for words, value in values:
        if not low <= value <= high:
            unit = UNITS[follows]
            what = f"{words} {value:.6g} {unit}, and the safety gate trips outside {low:.6g} to {high:.6g} {unit}"
            margin = "trip_level of limits.force" if follows == "force" else "position_margin from limits.position"
            yield BadInput(what, f"{where}: reference", f"values within that range, {margin} of the rig file")


def _programme_limits(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    """Reject limits that the rig cannot reach, since its gate trips before."""
    follows = CONTROLLERS.load(law).FOLLOWS
    for name, limits in _limits(spec):
        for kind, quantity in (("peak", follows), ("valley", follows), ("position", "position")):
            window = getattr(limits, kind)
            if window is None:
                continue
            low, high = _trip_range(spec, graph, quantity)
            if window[0] < low or window[1] > high:
                unit = UNITS[quantity]
                what = f"{kind} of block {name} is limited to {list(window)} {unit}, and the safety gate trips before"
                yield BadInput(what, f"{where}: programme: limits", f"a window within {low:.6g} to {high:.6g} {unit}")


def _range(spec: Spec, graph: Graph, law: str, where: str) -> Iterator[BadInput]:
    """Check that the converter of the followed reading covers the reference, and that of the command the valve."""
    if graph.bridge is None:
        return
    calibration, follows = graph.bridge.calibration, CONTROLLERS.load(law).FOLLOWS
    if follows in calibration.wired:
        low, high = _span(calibration.inputs[calibration.wired.index(follows)])
        for value in reference_extremes(spec):
            if not low < value < high:
                unit = UNITS[follows]
                ends = f"{low:.6g} and {high:.6g} {unit}"
                what = f"the reference reaches {value:.6g} {unit}, and the channel of {follows} ends at {ends}"
                yield BadInput(what, where, f"a smaller reference, or a {follows} channel with a wider range")
    limit = spec.rig.limits.spool
    low, high = _span(calibration.output)
    reach = min(-low, high)
    if reach < MIN_REACH * limit:
        what = (
            f"the command channel opens the valve by {reach:.3g} m at most, and the rig's limit of the spool is {limit:.3g} m"
        )
        yield BadInput(what, where, "a command range that covers limits.spool, or the smaller value there")


def _span(channel: Input | Output) -> tuple[float, float]:
    """Return the values of a channel at the ends of its range, in SI units."""
    ends = [channel.scale * (raw - channel.offset) for raw in channel.range]
    return min(ends), max(ends)


def _gate_of(spec: Spec, graph: Graph) -> GateParameters:
    """Return the gate's parameters with which a graph starts."""
    if graph.bridge is None:
        return tuned_for(GateParameters, spec.rig, SIMULATED)
    return within(tuned_for(GateParameters, spec.rig), bounds_of(spec.rig, spec.settings.control_period))


def _trip_range(spec: Spec, graph: Graph, quantity: str) -> tuple[float, float]:
    """Return the values of force [N] or position [m] between which the gate does not trip."""
    gate, limits = _gate_of(spec, graph), spec.rig.limits
    if quantity == "force":
        return -gate.trip_level * limits.force, gate.trip_level * limits.force
    return limits.position[0] + gate.position_margin, limits.position[1] - gate.position_margin


def _limits(spec: Spec) -> Iterator[tuple[str, ProgrammeLimits]]:
    """Yield name and limits of each block of a programme; nothing for another reference."""
    if spec.reference.name == "programme":
        for leaf in programme_of(spec.reference.parameters).leaves:
            yield leaf.name, leaf.limits


def _remarks(spec: Spec, graph: Graph) -> Iterator[str]:
    if graph.bridge is None:
        return
    signal = spec.disturbance.signal
    if signal.name != "constant" or signal.parameters.value != 0.0:
        kind = signal_kind(spec.disturbance.name)
        yield f"the disturbance of the experiment ({kind}, {signal.name}) is not sent: the actuator at the rig has to apply it"
    if spec.rig.effects:
        names = ", ".join(use.name for use in spec.rig.effects)
        yield f"the effects of the experiment ({names}) are those of the simulated rig and are not sent to the bridge"
