"""The law against hand-derived facts; the paper's equation numbers stand beside what they say."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from ehls_ros.control import bounds
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import base, fasmc
from ehls_ros.control.controllers.base import Model, model_of
from ehls_ros.physics import sensors
from ehls_ros.physics.plant import PL, XV, V, X
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import parse

FROZEN = {"phi1": 0.0, "phi2": 0.0, "phi3": 0.0, "forgetting": 0.0}
MPA = 1e6
ADAPTED = [fasmc.ALPHA, fasmc.BETA, fasmc.DELTA]
PRESSURE_RATE = [fasmc.CORRECTION, fasmc.LAST_PRESSURE, fasmc.LAST_RATE, fasmc.STARTED]

# The paper's rig and law in N, mm, MPa, t, s: e1 = 4 beta_e Ac/Vt, m0, Ac, and the reaching rate of the printed u3.
E1, M0, AREA = 4.784, 0.07, 2600.0
RATE = (25.0 + 25.0 * E1 * 5500.0 / 107.5) / M0


class Point(NamedTuple):
    """An operating point in SI units: the state, what is wanted, and the friction at work."""

    x: float
    v: float
    pressure: float
    spool: float
    wanted: float
    wanted_rate: float
    wanted_acceleration: float
    elements: float
    viscous: float

    def step(self, controller: Controller, supply: float) -> float:
        measured = reading(self.x, self.v, self.pressure, self.spool, supply)
        reference = np.array([self.wanted, self.wanted_rate, self.wanted_acceleration])
        return controller.step(measured, reference, np.array([self.elements, self.viscous]))


def reading(x: float, v: float, pressure: float, spool: float, supply: float = 7e6, force: float | None = None) -> np.ndarray:
    """Return what the sensors say; the load cell Ac pL where nothing else is said."""
    return np.array([x, v, pressure, spool, AREA * 1e-6 * pressure if force is None else force, supply, 313.0])


def points() -> list[Point]:
    random = np.random.default_rng(11)
    scale = np.array([0.1, 0.2, 4e6, 1e-3, 1e4, 3e4, 1e5, 800.0, 1500.0])
    return [Point(*(random.uniform(-1.0, 1.0, 9) * scale)) for _ in range(12)]


def controller(rig: Any, period: float = 1e-3, limit: float = 1e3, **values: Any) -> Controller:
    """Return the law with a spool limit that a check of the law itself never meets."""
    model = model_of(rig, period)._replace(spool_limit=limit)
    return Controller("fasmc", parse(fasmc.Parameters, values, "test"), model)


def start_at(law: Controller, alpha: float = 1.0, beta: float = 1.0, delta: float = 0.0) -> None:
    law._memory[ADAPTED] = alpha, beta, delta


class Loop:
    """The friction-free paper's plant (24) and the sliding variable (26), (27), written in SI."""

    def __init__(self, plant: Any, p: fasmc.Parameters) -> None:
        self.plant = plant
        self.p = p
        stiffness = 4.0 * plant.bulk_modulus / plant.total_volume
        self.e1, self.e2 = stiffness * plant.piston_area, stiffness * plant.leakage_coefficient
        self.flow = stiffness * plant.discharge_coefficient * plant.valve_area_gradient / math.sqrt(plant.oil_density)

    def rates(self, state: np.ndarray, command: float, friction: float) -> np.ndarray:
        x, v, pressure, spool = state
        c = self.plant
        side = 1.0 if spool.real >= 0.0 else -1.0
        force = c.piston_area * pressure - c.viscous_damping * v - c.spring_stiffness * x - c.moving_mass * c.gravity
        pressure_rate = -self.e1 * v - self.e2 * pressure + self.flow * np.sqrt(c.supply_pressure - side * pressure) * spool
        spool_rate = c.valve_bandwidth * (c.valve_gain * command - spool)
        return np.array([v, (force - friction) / c.moving_mass, pressure_rate, spool_rate])

    def s(self, state: np.ndarray, wanted: Any, wanted_rate: Any) -> Any:
        """Return s [Pa/s]; k, g in Pa/s and 1/Pa."""
        error = state[2] - wanted / self.plant.piston_area
        error_rate = self.rates(state, 0.0, 0.0)[2] - wanted_rate / self.plant.piston_area
        k, g = self.p.k * MPA, self.p.g / MPA
        return self.p.xi * error_rate + k / (1.0 + np.exp(-g * error)) - k / 2.0

    def s_rate(self, at: Point, command: float) -> float:
        """Return ds/dt along the motion, by complex step."""
        state = np.array(at[:4])
        h = 1e-30
        ahead = state + 1j * h * self.rates(state, command, at.elements + at.viscous)
        wanted = at.wanted + 1j * h * at.wanted_rate
        return float(np.imag(self.s(ahead, wanted, at.wanted_rate + 1j * h * at.wanted_acceleration)) / h)


@pytest.mark.parametrize("at", points())
@pytest.mark.parametrize("gravity", [9.81, -9.81])
def test_command_makes_the_plants_s_decay_at_the_implicit_rate(rig, at, gravity):
    rig = rig._replace(plant=rig.plant._replace(gravity=gravity))
    period = 1e-3
    law = controller(rig, period, **FROZEN)
    start_at(law)
    command = at.step(law, rig.plant.supply_pressure)
    loop = Loop(rig.plant, law.parameters)
    s = loop.s(np.array(at[:4]), at.wanted, at.wanted_rate)
    # (h + h xi e1 delta_f/b)/m0 with h = 25 t/s, b = 107.5 t MPa/s^2, e1 = 4.784 MPa/mm, m0 = 0.07 t
    rate = (25.0 + 25.0 * 4.784 * 5500.0 / 107.5) / 0.07
    assert rate == pytest.approx(8.78e4, rel=1e-3)
    # s' is affine in the command; solve it for s' = -K s/(1 + K T).
    free, per_metre = loop.s_rate(at, 0.0), loop.s_rate(at, 1.0) - loop.s_rate(at, 0.0)
    expected = (-rate * s / (1.0 + rate * period) - free) / per_metre
    # Cancellation between the terms costs digits; they are measured against the largest.
    assert command == pytest.approx(expected, rel=1e-9, abs=1e-9 * abs(free / per_metre))
    assert law.status[base.S] == pytest.approx(s / MPA, rel=1e-9)
    assert law.status[base.E3] == pytest.approx((at.pressure - at.wanted / rig.plant.piston_area) / MPA, rel=1e-12)


@pytest.mark.parametrize("at", points()[:4])
def test_s_shrinks_by_the_implicit_factor_over_one_cycle(rig, at):
    period = 2e-6
    law = controller(rig, period, **FROZEN)
    start_at(law)
    command = at.step(law, rig.plant.supply_pressure)
    loop = Loop(rig.plant, law.parameters)
    state, friction, steps = np.array(at[:4]), at.elements + at.viscous, 4
    before = loop.s(state, at.wanted, at.wanted_rate)
    for _ in range(steps):
        h = period / steps
        k1 = loop.rates(state, command, friction)
        k2 = loop.rates(state + 0.5 * h * k1, command, friction)
        k3 = loop.rates(state + 0.5 * h * k2, command, friction)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + loop.rates(state + h * k3, command, friction))
    wanted = at.wanted + at.wanted_rate * period + 0.5 * at.wanted_acceleration * period**2
    after = loop.s(state, wanted, at.wanted_rate + at.wanted_acceleration * period)
    rate = bounds.reaching_rate(25.0, 107.5, 1.0, 4.784, 5500.0, 0.07)
    assert after / before == pytest.approx(1.0 / (1.0 + rate * period), rel=2e-3)


def test_sliding_variable_of_a_point_worked_out_by_hand(rig):
    # At rest, spool 0.1 mm, pL = 3 MPa, 10 kN wanted: e3 = 3 - 3.846154 = -0.846154 MPa, g e3 = -50.769, so
    # phi = -6 MPa/s. x3' = -e2 3 + e3 sqrt(7 - 3) 0.1, e2 = 1.84e12 4.7e-12 = 8.648 1/s,
    # e3 = 1.84e12 0.62 0.0267/sqrt(840) = 1.050948e9: -25.944 + 210.190 = 184.246 MPa/s.
    law = controller(rig)
    Point(0.0, 0.0, 3e6, 1e-4, 1e4, 0.0, 0.0, 0.0, 0.0).step(law, 7e6)
    assert law.status[base.E3] == pytest.approx(-0.846154, abs=1e-6)
    assert law.status[base.S] == pytest.approx(184.2456 - 6.0, abs=1e-3)


def test_the_papers_numbers_give_the_papers_controller(rig):
    law = controller(rig, **FROZEN, k=12, g=60, h=25, b=107.5)
    start_at(law)
    Point(0.01, 0.02, 1e6, 1e-4, 3e3, 0.0, 0.0, 0.0, 0.0).step(law, 7e6)
    assert law.status[base.FORCE_BOUND] == pytest.approx(78.1, abs=0.1)
    implicit = -law.status[base.U3] / (0.07 * law.status[base.S])
    assert implicit / (1.0 - 1e-3 * implicit) == pytest.approx(8.78e4, rel=1e-3)
    assert law.parameters[:6] == fasmc.Parameters()[:6]  # the defaults are the paper's


def test_no_compensation_is_left_out_and_the_parts_make_the_command(rig):
    at = points()[0]
    law = controller(rig, **FROZEN)
    start_at(law, 1.3, 0.7, -250.0)
    command = at.step(law, 7e6)
    # (35): u1 = -xi e1 (alpha A^T B + beta sigma_f x2 + D)
    assert law.status[base.U1] == pytest.approx(-4.784 * (1.3 * at.elements + 0.7 * at.viscous - 250.0), rel=1e-9)
    # (34): command [mm] = (u1 + u2 + u3)/(m0 xi e5 g3)
    side = 1.0 if at.spool >= 0.0 else -1.0
    g3 = 1.050948e3 * math.sqrt(7.0 - side * at.pressure / MPA)
    parts = law.status[base.U1] + law.status[base.U2] + law.status[base.U3]
    assert command * 1e3 == pytest.approx(parts / (0.07 * 111.46370743 * g3), rel=1e-6)


@pytest.mark.parametrize("towards", [1.0, -1.0])
@pytest.mark.parametrize("motion", [1.0, -1.0])
def test_adaptation_goes_the_way_of_36_to_38(rig, towards, motion):
    law = controller(rig, phi1=1e-4, phi2=2e-4, phi3=3e-4, forgetting=0.0)
    start_at(law)
    at = Point(0.0, 0.05 * motion, towards * 5e5 + 1e6, 0.0, 2600.0, towards * -9e5, 0.0, 640.0 * motion, 363.0 * motion)
    at.step(law, 7e6)
    s = law.status[base.S]
    assert s * towards > 1.0
    alpha, beta, delta = law._memory[ADAPTED] - [1.0, 1.0, 0.0]
    assert delta * s > 0.0
    assert alpha == pytest.approx(delta / 3.0 * at.elements, rel=1e-9)
    assert beta == pytest.approx(delta * 2.0 / 3.0 * at.viscous, rel=1e-9)


def test_alpha_and_beta_return_to_one_where_nothing_moves_them(rig):
    law = controller(rig, **{**FROZEN, "forgetting": 0.5})
    start_at(law, 2.0, 0.6, 40.0)
    for _ in range(2000):
        points()[0].step(law, 7e6)
    # Two seconds at 0.5 1/s: by exp(1); D does not forget.
    assert law._memory[ADAPTED] == pytest.approx([1.0 + math.exp(-1.0), 1.0 - 0.4 * math.exp(-1.0), 40.0], rel=1e-3)


def test_cut_adaptation_leaves_the_rest_of_s_to_the_robust_term(rig):
    at = points()[1]
    at = at._replace(elements=0.0, viscous=0.0)
    free = controller(rig, phi3=2e6, delta_maximum=1e6)
    cut = controller(rig, phi3=2e6, delta_maximum=0.0)
    none = controller(rig, **FROZEN)
    for law in (free, cut, none):
        start_at(law)
        at.step(law, 7e6)
    assert abs(free.status[base.U3]) < 0.2 * abs(none.status[base.U3])
    assert cut.status[base.U3] == pytest.approx(none.status[base.U3], rel=1e-9)
    # Uncut, u3 and the adaptation together act on the s they foresee.
    foreseen = -free.status[base.U3] / 0.07 / 8.7844e4
    assert free._memory[2] == pytest.approx(1e-3 * 2e6 * 4.784 * foreseen, rel=1e-3)


def test_discrete_law_tends_to_the_continuous_one_with_order_one(rig):
    at = points()[2]._replace(elements=600.0, viscous=90.0)
    tuning = {"phi1": 0.1, "phi2": 0.05, "phi3": 2e6, "forgetting": 0.0}
    errors = []
    loop = Loop(rig.plant, fasmc.Parameters())
    s = loop.s(np.array(at[:4]), at.wanted, at.wanted_rate)
    rate = bounds.reaching_rate(25.0, 107.5, 1.0, 4.784, 5500.0, 0.07)
    free, per_metre = loop.s_rate(at, 0.0), loop.s_rate(at, 1.0) - loop.s_rate(at, 0.0)
    continuous = np.array(
        [
            (-rate * s - free) / per_metre,  # (34), (35)
            0.1 * 4.784 * 600.0 * s / MPA,  # (36)
            0.05 * 4.784 * 90.0 * s / MPA,  # (37)
            2e6 * 4.784 * s / MPA,  # (38)
        ]
    )
    for period in (4e-8, 2e-8, 1e-8):
        law = controller(rig, period, scale_maximum=100.0, scale_minimum=1e-6, **tuning)
        start_at(law)
        command = at.step(law, 7e6)
        discrete = np.array([command, *((law._memory - [1.0, 1.0, 0.0]) / period)])
        errors.append(np.abs(discrete - continuous) / np.abs(continuous))
    assert np.all(errors[-1] < 2e-3)
    assert np.allclose(errors[0] / errors[1], 2.0, rtol=0.05)
    assert np.allclose(errors[1] / errors[2], 2.0, rtol=0.05)


@pytest.mark.parametrize("seed", range(6))
def test_any_finite_measurement_leaves_command_and_memory_within_their_limits(rig, seed):
    random = np.random.default_rng(seed)
    law = controller(rig, limit=rig.limits.spool)
    p = law.parameters
    usual = np.array([0.1, 0.3, 5e6, 5e-3, 1e4, 7e6, 300.0])
    for cycle in range(1500):
        wild = 10.0 ** random.uniform(-30.0, [3.0, 30.0, 307.0][cycle % 3], 12) * random.choice([-1.0, 1.0], 12)
        wild[random.random(12) < 0.2] = 0.0
        keep = random.random(7) < 0.5
        measured = np.where(keep, usual * random.standard_normal(7), wild[:7])
        command = law.step(measured, wild[7:10], wild[10:])
        place = f"seed {seed}, cycle {cycle}: {measured}, {wild[7:]}"
        assert abs(command) <= rig.limits.spool, place
        assert p.scale_minimum <= law._memory[0] <= p.scale_maximum, place
        assert p.scale_minimum <= law._memory[1] <= p.scale_maximum, place
        assert abs(law._memory[2]) <= p.delta_maximum, place


@pytest.mark.parametrize("signal", range(6))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_broken_sensor_gives_a_finite_command_and_leaves_no_trace(rig, signal, value):
    law = controller(rig, limit=0.01)
    points()[3].step(law, 7e6)
    broken = np.array([0.0, 0.0, 1e6, 1e-4, 2600.0, 7e6, 313.0])
    broken[signal] = value
    command = law.step(broken, np.array([1e4, 0.0, 0.0]), np.array([0.0, 0.0]))
    assert abs(command) <= 0.01
    assert np.all(np.isfinite(law._memory))


class Run(NamedTuple):
    """What a closed loop did, a row a cycle."""

    force: np.ndarray
    command: np.ndarray
    memory: np.ndarray


def closed_loop(rig: Any, law: Controller, cycles: int, wanted: Any, *, limit: Any = None, disturbance: float = 0.0) -> Run:
    """Run the law on the simulated rig with the plant's own friction as its estimate."""
    simulator = Simulator(rig, 1e-3)
    run = Run(np.empty(cycles), np.empty(cycles), np.empty((cycles, 3)))
    for k in range(cycles):
        if limit is not None:
            law.model = law.model._replace(spool_limit=limit(k))
        y = simulator.y
        measured = np.array([y[X], y[V], y[PL], y[XV], rig.plant.piston_area * y[PL], rig.plant.supply_pressure, 313.0])
        friction = np.array([y[XV + 1 : XV + 4].sum(), rig.friction.viscous_coefficient * y[V]])
        run.force[k] = measured[sensors.FORCE]
        run.command[k] = law.step(measured, np.asarray(wanted(k * 1e-3), dtype=float), friction)
        run.memory[k] = law._memory[ADAPTED]
        omega = 2.0 * np.pi
        push, push_rate = disturbance * np.sin(omega * k * 1e-3), omega * disturbance * np.cos(omega * k * 1e-3)
        simulator.advance(run.command[k], push, push_rate, 0.0, 0.0)
    return run


def test_two_seconds_beyond_the_supply_pressure_leave_no_wind_up(rig):
    law = controller(rig, limit=rig.limits.spool)
    run = closed_loop(rig, law, 3500, lambda t: [2.5e4 if t < 2.0 else 1e4, 0.0, 0.0])
    assert run.force[1990] == pytest.approx(18.2e3, rel=0.02)  # Ac ps: more the supply cannot do
    assert np.max(np.abs(run.memory[:, 2])) < 0.9 * law.parameters.delta_maximum
    # 8.2 kN at k/2 Ac = 15.6 kN/s take 0.53 s.
    assert np.max(np.abs(run.force[2700:] - 1e4)) < 78.1


def test_two_seconds_at_a_narrow_spool_limit_leave_no_wind_up(rig):
    law = controller(rig, limit=rig.limits.spool)
    swing = 2.0 * np.pi * 0.5

    def sine(t: float) -> list[float]:
        angle = swing * t
        return [1e4 * np.sin(angle), 1e4 * swing * np.cos(angle), -1e4 * swing**2 * np.sin(angle)]

    run = closed_loop(rig, law, 5000, sine, limit=lambda k: 1e-5 if 1000 <= k < 3000 else 0.01, disturbance=2e3)
    wanted = np.array([sine(k * 1e-3)[0] for k in range(5000)])
    error = np.abs(run.force - wanted)
    assert np.max(error[500:1000]) < 78.1
    assert np.max(error[1000:3000]) > 1e3
    assert np.max(np.abs(run.memory[1000:3000, 2])) < 0.9 * law.parameters.delta_maximum
    assert np.max(error[4200:]) < 78.1


def test_a_load_beyond_the_supply_pressure_lets_go_again(rig):
    # The rod is pushed until pL passes the supply pressure with the spool wide open: the orifice's slope is singular there.
    law = controller(rig, limit=rig.limits.spool)
    simulator = Simulator(rig, 1e-3)
    simulator.y[PL], simulator.y[XV] = -7.1e6, -0.01
    simulator.y[X] = -0.45
    error = []
    for _k in range(3000):
        y = simulator.y
        measured = np.array([y[X], y[V], y[PL], y[XV], rig.plant.piston_area * y[PL], 7e6, 313.0])
        friction = np.array([y[XV + 1 : XV + 4].sum(), rig.friction.viscous_coefficient * y[V]])
        command = law.step(measured, np.array([1e4, 0.0, 0.0]), friction)
        simulator.advance(command, 0.0, 0.0, 0.0, 0.0)
        error.append(abs(measured[sensors.FORCE] - 1e4))
    assert max(error[2500:]) < 78.1


def test_step_does_not_depend_on_what_it_was_given_before_but_through_its_memory(rig):
    law: Controller = controller(rig, limit=0.01)
    first = [at.step(law, 7e6) for at in points()]
    law.reset()
    assert [at.step(law, 7e6) for at in points()] == first


def test_model_is_the_nominal_rig_without_effects(rig):
    model = model_of(rig, 1e-3)
    assert model == Model(rig.plant, 1e-3, rig.limits.spool)
