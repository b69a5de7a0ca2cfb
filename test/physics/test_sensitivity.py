"""Derivatives of trajectories: against central differences through stick and slip, impacts and delays, and closed forms."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numba import types

from ehls_ros.duals import DualArrayType, DualRecordType, DualType
from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.physics.sensitivity import Inputs, sensitivities
from ehls_ros.physics.simulator import Simulator

PERIOD = 1e-3

TEN = (
    "plant.supply_pressure", "plant.bulk_modulus", "plant.discharge_coefficient", "plant.moving_mass", "plant.valve_bandwidth",
    "friction.coulomb_force", "friction.static_force", "friction.viscous_coefficient", "friction.element_stiffness_1",
    "friction.attraction_rate",
)  # fmt: skip

STOPPED = (
    "plant.moving_mass", "friction.static_force", "friction.stribeck_velocity", "effects.end_stop.upper",
    "effects.end_stop.stiffness", "effects.command_delay.delay",
)  # fmt: skip


def sine(cycles: int, spool: float, frequency: float, force: float = 0.0, mean: float = 0.0) -> Inputs:
    t = 2.0 * np.pi * frequency * np.arange(cycles) * PERIOD
    rate = 2.0 * np.pi * frequency
    return Inputs(spool * np.sin(t) + mean, force * np.sin(t + 0.7), force * rate * np.cos(t + 0.7))


def moved(rig: Rig, path: str, by: float) -> Rig:
    """Return a rig with one number changed by a fraction of it."""
    section, *rest = path.split(".")
    if section == "effects":
        name, key = rest
        changed = [
            u._replace(parameters=u.parameters._replace(**{key: getattr(u.parameters, key) * (1.0 + by)}))
            if u.name == name else u
            for u in rig.effects
        ]  # fmt: skip
        return rig._replace(effects=tuple(changed))
    part, [key] = getattr(rig, section), rest
    if key.startswith("element_stiffness_"):
        index = int(key[-1]) - 1
        values = tuple(k * (1.0 + by * (i == index)) for i, k in enumerate(part.element_stiffness))
        return rig._replace(**{section: part._replace(element_stiffness=values)})
    return rig._replace(**{section: part._replace(**{key: getattr(part, key) * (1.0 + by)})})


def number(rig: Rig, path: str) -> float:
    """Return a number of a rig."""
    section, *rest = path.split(".")
    if section == "effects":
        return float(next(getattr(u.parameters, rest[1]) for u in rig.effects if u.name == rest[0]))
    name = rest[0]
    if name.startswith("element_stiffness_"):
        return float(rig.friction.element_stiffness[int(name[-1]) - 1])
    return float(getattr(getattr(rig, section), name))


STEP = 2e-5
"""Integration step [s]. Where an event moves into the next step, a trajectory bends by the method's error."""


def largest_error(rig: Rig, paths: Sequence[str], inputs: Inputs, change: float) -> float:
    """Return the largest error against central differences, relative to the largest derivative of its signal.

    A difference's step changes the signal that depends most on it by about ``change`` of its largest value.
    """
    found, seen = sensitivities(rig, paths, inputs, step=STEP), 0
    assert found.dense == 0
    size, worst = np.max(np.abs(found.readings), axis=0), 0.0
    for index, path in enumerate(paths):
        largest = np.max(np.abs(found.derivatives[:, :, index]), axis=0)
        by = change / max(float(np.max(number(rig, path) * largest[size > 0.0] / size[size > 0.0])), 1e-3)
        step = by * number(rig, path)
        ends = [sensitivities(moved(rig, path, s * by), paths, inputs, step=STEP).readings for s in (-2, -1, 1, 2)]
        differences = (8.0 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / (12.0 * step)
        # For smaller changes, rounding leaves less than seven digits.
        told = step * largest > 1e-9 * size
        seen += int(np.sum(told) >= 3)
        error = np.max(np.abs(found.derivatives[:, :, index] - differences), axis=0)
        worst = max(worst, float(np.max(error[told] / largest[told], initial=0.0)))
    assert seen >= len(paths) - 2
    return worst


def test_smooth_sliding_agrees_with_central_differences(make_rig: Any) -> None:
    rig, inputs = make_rig(), sine(300, 2e-4, 3.0, 2e3, mean=5e-4)
    assert np.all(sensitivities(rig, TEN, inputs).readings[20:, SENSED.index("velocity")] > 0.0)
    assert largest_error(rig, TEN, inputs, 1e-4) <= 1e-6


def test_stick_and_slip_of_elements_agree_with_central_differences(make_rig: Any) -> None:
    rig, inputs = make_rig(), sine(300, 8e-5, 10.0)
    velocity = sensitivities(rig, TEN, inputs).readings[:, SENSED.index("velocity")]
    assert np.sum(np.diff(np.sign(velocity)) != 0) >= 6
    assert largest_error(rig, TEN, inputs, 1e-5) <= 1e-6


@pytest.fixture(scope="module")
def stopped(make_rig: Any) -> Rig:
    """Static friction, an end stop and a delayed command."""
    effects = [
        {"name": "end_stop", "upper": 0.004, "lower": -0.05, "stiffness": 5e6, "damping": 0.0, "loss": 2.0, "exponent": 1.5},
        {"name": "command_delay", "delay": 0.002337},
    ]
    rig: Rig = make_rig(friction={"model": "stribeck"}, effects=effects)
    return rig


@pytest.mark.long
def test_stick_slip_agrees_with_central_differences(stopped: Rig) -> None:
    inputs = sine(500, 1.5e-5, 4.0)
    paths = [*(path for path in STOPPED if "end_stop" not in path), "plant.bulk_modulus", "plant.spring_stiffness"]
    sticks = sensitivities(stopped, paths, inputs).readings[:, SENSED.index("velocity")] == 0.0
    assert np.sum(np.diff(sticks.astype(int)) == 1) >= 8
    assert largest_error(stopped, paths, inputs, 3e-6) <= 1e-6


@pytest.mark.long
def test_impacts_on_an_end_stop_agree_with_central_differences(stopped: Rig) -> None:
    inputs = sine(500, 4e-4, 5.0, 2e3)
    inside = sensitivities(stopped, STOPPED, inputs).readings[:, SENSED.index("position")] > 0.004
    assert np.sum(np.diff(inside.astype(int)) == 1) >= 2
    assert largest_error(stopped, STOPPED, inputs, 3e-6) <= 1e-6


def test_the_readings_are_the_simulator_s_to_the_bit(make_rig: Any) -> None:
    inputs = sine(300, 8e-5, 10.0, 5e2)
    found, simulator = sensitivities(make_rig(), TEN, inputs), Simulator(make_rig(), PERIOD)
    for k, reading in enumerate(found.readings):
        assert np.array_equal(simulator.measure(np.zeros(len(SENSED))), reading)
        simulator.advance(*(float(np.asarray(column)[k]) for column in inputs[:3]), 0.0, 0.0)


def test_a_delayed_step_of_the_spool_has_the_closed_form(stopped: Rig) -> None:
    command, delay = 1e-4, 0.002337
    inputs = Inputs(np.full(60, command))
    paths = ["plant.valve_bandwidth", "plant.valve_gain", "effects.command_delay.delay", "start.spool"]
    paths += ["sensors.spool_position.gain", "sensors.spool_position.bias"]
    found = sensitivities(stopped, paths, inputs).derivatives[:, SENSED.index("spool_position")]
    omega, gain, t = stopped.plant.valve_bandwidth, stopped.plant.valve_gain, np.arange(60) * PERIOD
    since = np.maximum(t - delay, 0.0)
    left = np.where(since > 0.0, np.exp(-omega * since), 1.0)
    reading = gain * command * (1.0 - left)
    exact = [
        gain * command * since * left,
        command * (1.0 - left),
        -gain * command * omega * left * (since > 0.0),
        np.exp(-omega * t),
        reading,
        np.ones(60),
    ]
    for column, expected in zip(found.T, exact, strict=True):
        # The Runge-Kutta step's error is (ω h)^4 / 120.
        assert column == pytest.approx(expected, abs=2e-6 * float(np.max(np.abs(expected))))


@pytest.mark.parametrize(
    ("path", "changes", "what"),
    [
        ("plant.mass", {}, "plant.moving_mass"),
        ("effects.command_delay.delay", {"delay": 2e-3}, "2 whole control periods"),
        ("plant.moving_mass", {"damping": 1e4}, "end_stop has a damping"),
        ("sensors.force.delay", {}, "the delay of the sensor of force"),
        ("plant.moving_mass", {"resolution": 1e-6}, "reads in steps"),
    ],
)
def test_what_has_no_derivative_is_refused_by_name(make_rig: Any, path: str, changes: Mapping[str, float], what: str) -> None:
    effects = [{"name": "command_delay", "delay": changes.get("delay", 1.5e-3)}]
    if "damping" in changes:
        effects.append({"name": "end_stop", "upper": 0.01, **changes})
    rig = make_rig(effects=effects, sensors={"position": {"resolution": changes.get("resolution", 0.0)}})
    with pytest.raises(BadInput, match=what):
        sensitivities(rig, [path], Inputs(np.zeros(3)))


WIDTH = 8
DUAL, DUALS, FLOATS = DualType(WIDTH), DualArrayType(WIDTH, 1), types.Array(types.float64, 1, "C")


def record(parameters: Any) -> DualRecordType:
    lists = tuple(name for name in parameters._fields if name.startswith("element_"))
    return DualRecordType(WIDTH, tuple(name for name in parameters._fields if name not in lists), lists)


@pytest.mark.parametrize("name", FRICTION_MODELS.names())
def test_every_friction_model_is_differentiable(name: str) -> None:
    model: Any = FRICTION_MODELS.load(name)
    p = record(model.Parameters)
    around = (DUAL, DUAL, DUAL, DUALS, FLOATS, p)
    calls = {
        "level": (DUAL, p), "force": around, "event": around, "switch": around, "begin": (DUAL, DUAL, p, DUALS),
        "rates": (DUAL, DUAL, DUALS, FLOATS, p, DUALS),
    }  # fmt: skip
    for function, arguments in calls.items():
        assert getattr(model, function).get_call_template(arguments, {})[0] is not None


@pytest.mark.parametrize("name", EFFECTS.names())
def test_every_effect_is_differentiable(name: str) -> None:
    effect: Any = EFFECTS.load(name)
    fields = len(effect.Parameters._fields)
    p = types.NamedTuple([DUAL] * fields, effect.Parameters)
    seen = (DUAL, DUALS, FLOATS, DUALS, p, record(Plant))
    calls = dict.fromkeys(HOOKS, (DUAL, *seen)) | {"derivatives": (DUAL, *seen, DUALS), "jump": (DUAL, FLOATS, p)}
    for hook, arguments in calls.items():
        if hasattr(effect, hook):
            getattr(effect, hook).compile(arguments)
