"""The two controllers the law is compared and identified with."""

import math
from typing import Any

import numpy as np
import pytest

from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import SATURATED, model_of
from ehls_ros.physics.plant import PL, XV, V, X
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import parse

PERIOD = 1e-3


def run(
    rig: Any, name: str, cycles: int, *, disturbance: float = 0.0, wanted: Any = None, limit: Any = None, **values: Any
) -> dict[str, np.ndarray]:
    """Run a controller on the simulated rig against a sine of 0.5 Hz."""
    law = Controller(name, parse(CONTROLLERS.load(name).Parameters, values, "test"), model_of(rig, PERIOD))
    simulator = Simulator(rig, PERIOD)
    out = {key: np.empty(cycles) for key in ("position", "velocity", "force", "command", "saturated")}
    for k in range(cycles):
        y, t = simulator.y, k * PERIOD
        if limit is not None:
            law.model = law.model._replace(spool_limit=limit(t))
        measured = np.array([y[X], y[V], y[PL], y[XV], rig.plant.piston_area * y[PL], rig.plant.supply_pressure, 313.0])
        reference = np.array([0.0 if wanted is None else wanted(t), 0.0, 0.0])
        command = law.step(measured, reference, np.zeros(2))
        for key, value in zip(out, (*measured[[0, 1, 4]], command, law.status[SATURATED]), strict=True):
            out[key][k] = value
        rate = disturbance * math.pi * math.cos(math.pi * t)
        simulator.advance(command, disturbance * math.sin(math.pi * t), rate, 0.0, 0.0)
    return out


@pytest.fixture
def loose(rig):
    """A rig all but free of dry friction, whose rod a disturbance moves by centimetres without ringing."""
    friction = rig.friction._replace(coulomb_force=1.0, static_force=1.0, viscous_coefficient=0.0)
    return rig._replace(friction=friction, plant=rig.plant._replace(gravity=0.0, viscous_damping=3e3))


def test_compensation_makes_the_force_invariant_to_the_rods_motion(loose):
    errors = {}
    for part in (0.0, 1.0):
        out = run(loose, "sic", 5000, disturbance=2e3, compensation=part)
        assert np.ptp(out["position"]) > (0.05 if part else 0.005)
        errors[part] = np.max(np.abs(out["force"][3000:]))
    assert errors[0.0] > 500.0
    assert errors[1.0] < 0.02 * errors[0.0]


def test_sic_holds_a_constant_force_without_a_lasting_error(rig):
    out = run(rig, "sic", 4000, wanted=lambda t: 1e4)
    assert np.max(np.abs(out["force"][3000:] - 1e4)) < 20.0


def test_sic_does_not_wind_up_beyond_the_supply_pressure(rig):
    out = run(rig, "sic", 4000, wanted=lambda t: 3e4 if t < 2.0 else 1e4)
    assert out["force"][1500] > 18e3  # Ac ps = 18.2 kN
    assert np.max(np.abs(out["force"][3500:] - 1e4)) < 200.0


def test_sic_does_not_wind_up_at_a_narrow_spool_limit(rig):
    out = run(rig, "sic", 5000, wanted=lambda t: 1e4, limit=lambda t: 2e-5 if 1.0 < t < 3.0 else 0.01, disturbance=2e3)
    assert np.max(out["saturated"][1000:3000]) == 1.0
    assert np.max(np.abs(out["force"][1000:3000] - 1e4)) > 500.0
    assert np.max(np.abs(out["force"][3500:] - 1e4)) < 150.0


@pytest.mark.parametrize("velocity", [0.002, 0.01, 0.03, 0.09, 0.15])
def test_pid_moves_at_constant_velocity_and_turns_round(rig, velocity):
    travel = 0.02 if velocity < 0.02 else 0.2
    cycles = int(3.0 * travel / velocity / PERIOD)
    there = run(rig, "pid", cycles, velocity=velocity, travel=travel)
    back = run(rig, "pid", cycles, velocity=-velocity, travel=travel)
    for out, sign in ((there, 1.0), (back, -1.0)):
        # Away from start and turning points, on each of the three stretches.
        t = np.arange(cycles) * PERIOD * velocity / travel
        for direction, first, last in ((sign, 0.3, 0.45), (-sign, 0.7, 1.4), (sign, 1.7, 2.4)):
            stretch = out["velocity"][(t > first) & (t < last)]
            assert np.mean(stretch) == pytest.approx(direction * velocity, rel=0.01)
            assert np.max(np.abs(stretch - direction * velocity)) < 0.03 * velocity
        assert np.max(np.abs(out["position"])) == pytest.approx(0.5 * travel, rel=0.02)
        assert np.max(out["saturated"]) == 0.0


def test_pid_starts_where_the_rod_is(rig):
    law = Controller("pid", parse(CONTROLLERS.load("pid").Parameters, {"velocity": 0.01}, "test"), model_of(rig, PERIOD))
    measured = np.array([0.17, 0.0, 0.0, 0.0, 0.0, 7e6, 313.0])
    command = law.step(measured, np.zeros(3), np.zeros(2))
    # The flow of 10 mm/s and a little: Ac v/(Cd w sqrt(ps/rho)) = 17.2 um
    assert 17e-6 < command < 23e-6


def test_pid_does_not_wind_up_at_the_spool_limit(rig):
    # At 20 um of spool the rod makes some 10 mm/s of the 50 wanted.
    out = run(rig, "pid", 9000, velocity=0.05, travel=0.2, limit=lambda t: 2e-5 if 1.0 < t < 2.5 else 0.01)
    assert np.max(out["saturated"][1000:2500]) == 1.0
    assert np.max(np.abs(out["position"])) < 0.13
    for start in (7000, 8000):
        stretch = np.abs(out["velocity"][start : start + 300])
        if np.ptp(np.sign(out["velocity"][start - 300 : start + 600])) == 0.0:
            assert np.max(np.abs(stretch - 0.05)) < 0.03 * 0.05
