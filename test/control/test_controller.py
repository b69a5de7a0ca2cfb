"""The controller around the laws: change of tuning, reset, and the contract of every law."""

import math
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS, base, fasmc
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.physics import sensors
from ehls_ros.physics.plant import PL, XV, V, X
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import parse

PERIOD = 1e-3
OMEGA = 2.0 * math.pi


def make(rig: Any, name: str = "fasmc", **values: Any) -> Controller:
    return Controller(name, parse(CONTROLLERS.load(name).Parameters, values, "test"), model_of(rig, PERIOD))


def measure(rig: Any, simulator: Simulator) -> np.ndarray:
    y = simulator.y
    return np.array([y[X], y[V], y[PL], y[XV], rig.plant.piston_area * y[PL], rig.plant.supply_pressure, 313.0])


def model_rate(rig: Any, measured: np.ndarray) -> float:
    """Return the load pressure's rate by (25) [Pa/s]."""
    plant = rig.plant
    _, velocity, pressure, spool = measured[:4]
    orifice = plant.discharge_coefficient * plant.valve_area_gradient * spool
    flow = orifice * math.sqrt((plant.supply_pressure - math.copysign(pressure, spool)) / plant.oil_density)
    stiffness = 4.0 * plant.bulk_modulus / plant.total_volume
    return stiffness * (flow - plant.piston_area * velocity - plant.leakage_coefficient * pressure)


class Bench:
    """A closed loop that can be inspected between two cycles: 10 sin(pi t) kN against 5 sin(2 pi t) kN."""

    def __init__(self, rig: Any, law: Controller) -> None:
        self.rig, self.law, self.cycle = rig, law, 0
        self.simulator = Simulator(rig, PERIOD)
        self.estimator = FrictionEstimator("gms", rig, PERIOD)

    def step(self) -> tuple[np.ndarray, np.ndarray, float]:
        t = self.cycle * PERIOD
        angle = 0.5 * OMEGA * t
        wanted = 1e4 * np.array([math.sin(angle), 0.5 * OMEGA * math.cos(angle), -((0.5 * OMEGA) ** 2) * math.sin(angle)])
        measured = measure(self.rig, self.simulator)
        command = self.law.step(measured, wanted, self.estimator.update(measured[sensors.VELOCITY]))
        self.simulator.advance(command, 5e3 * math.sin(OMEGA * t), 5e3 * OMEGA * math.cos(OMEGA * t), 0.0, 0.0)
        self.cycle += 1
        return measured, wanted, command


@pytest.mark.parametrize("new", [{"k": 24.0}, {"k": 3.0}, {"g": 200.0}, {"b": 300.0, "h": 80.0}, {"phi3": 1e5}])
def test_retuning_makes_no_bump_and_counts_at_once(rig, new):
    law = make(rig)
    bench, unchanged = Bench(rig, law), Bench(rig, make(rig))
    steps = [bench.step() for _ in range(2310)]
    commands = [command for _, _, command in steps]
    assert [unchanged.step()[2] for _ in range(2310)] == commands
    before = np.max(np.abs(np.diff(commands[1500:])))
    last = steps[-1][0]
    p = parse(fasmc.Parameters, new, "test")
    law.retune(p)
    measured, wanted, command = bench.step()
    assert abs(command - commands[-1]) <= before
    assert command == pytest.approx(unchanged.step()[2], rel=0.0, abs=1e-12)
    # (27) with the new k and g, in MPa; the rate is (25) with what it missed from the last cycle to this one
    area = rig.plant.piston_area
    rate, last_rate = (model_rate(rig, reading) for reading in (measured, last))
    rate += (measured[2] - last[2]) / PERIOD - 0.5 * (rate + last_rate)
    error = (measured[2] - wanted[0] / area) / 1e6
    s = (rate - wanted[1] / area) / 1e6 + p.k / (1.0 + math.exp(-p.g * error)) - p.k / 2.0
    assert law.status[base.S] == pytest.approx(s, rel=1e-9)
    assert law.parameters == p
    after = [command] + [bench.step()[2] for _ in range(600)]
    assert np.max(np.abs(np.diff(after[:100]))) <= 2.0 * before
    # The change leaves no trace: a controller with the new tuning and this memory gives the same command.
    fresh = make(rig, **new)
    fresh._memory = law._memory.copy()
    measured = measure(rig, bench.simulator)
    friction = bench.estimator.state.estimate
    assert law.step(measured, wanted, friction) == pytest.approx(fresh.step(measured, wanted, friction), abs=1e-11)


@pytest.mark.parametrize("cycles", [1, 4, 20])
def test_what_retuning_has_taken_off_fades_with_time_also_over_unanswered_cycles(rig, cycles):
    law, fresh = make(rig), make(rig, k=24.0)
    measured = np.array([0.01, 0.02, 1e6, 1e-4, 2600.0, 7e6, 313.0])
    reference, friction = np.array([2.5e3, 1e3, 0.0]), np.array([300.0, 145.0])
    law.step(measured, reference, friction)
    law.retune(fresh.parameters)
    fresh._memory = law._memory.copy()
    bump = law.step(measured, reference, friction) - fresh.step(measured, reference, friction)
    assert abs(bump) > 1e-6
    left = law.step(measured, reference, friction, cycles) - fresh.step(measured, reference, friction, cycles)
    assert left == pytest.approx(bump * math.exp(-cycles * PERIOD / 0.02), rel=1e-6)


def test_retuning_twice_before_a_step_starts_from_the_tuning_in_force(rig):
    once, twice = Bench(rig, make(rig)), Bench(rig, make(rig))
    for _ in range(700):
        once.step()
        twice.step()
    new = parse(fasmc.Parameters, {"k": 20.0}, "test")
    twice.law.retune(parse(fasmc.Parameters, {"k": 300.0}, "test"))
    for bench in (once, twice):
        bench.law.retune(new)
    for _ in range(50):
        assert once.step()[2] == twice.step()[2]


def test_reset_forgets_everything_but_the_tuning(rig):
    law = make(rig, k=15.0)
    first = [bench.step()[2] for bench in [Bench(rig, law)] for _ in range(300)]
    law.retune(parse(fasmc.Parameters, {"k": 18.0}, "test"))
    Bench(rig, law).step()
    law.retune(parse(fasmc.Parameters, {"k": 15.0}, "test"))
    law.reset()
    assert np.array_equal(law.status, np.zeros(base.STATUS_SIZE))
    bench = Bench(rig, law)
    assert [bench.step()[2] for _ in range(300)] == first


@pytest.mark.parametrize("name", CONTROLLERS.names())
def test_a_new_controller_is_as_after_reset(rig, name):
    law, other = make(rig, name), make(rig, name)
    measured = np.array([0.01, 0.02, 1e6, 1e-4, 2600.0, 7e6, 313.0])
    reference, friction = np.array([5e3, 1e3, 0.0]), np.array([300.0, 145.0])
    first = [law.step(measured, reference, friction) for _ in range(5)]
    law.reset()
    assert [law.step(measured, reference, friction) for _ in range(5)] == first
    assert [other.step(measured, reference, friction) for _ in range(5)] == first


@pytest.mark.parametrize("name", CONTROLLERS.names())
def test_a_step_after_unanswered_cycles_is_that_of_the_longer_period(rig, name):
    late = make(rig, name)
    slow = Controller(name, late.parameters, late.model._replace(period=7 * PERIOD))
    reference, friction = np.array([5e3, 1e3, 0.0]), np.array([300.0, 145.0])
    late.step(np.array([0.01, 0.02, 1e6, 1e-4, 2600.0, 7e6, 313.0]), reference, friction)
    slow._memory[:] = late._memory
    measured = np.array([0.0101, 0.021, 1.02e6, 1.1e-4, 2640.0, 7e6, 313.0])
    assert late.step(measured, reference, friction, 7) == slow.step(measured, reference, friction)
    assert late._memory.tobytes() == slow._memory.tobytes()
    assert late.status.tobytes() == slow.status.tobytes()
    # The cycle after it is a regular one.
    usual = make(rig, name)
    usual._memory[:] = late._memory
    assert late.step(measured, reference, friction) == usual.step(measured, reference, friction)


@pytest.mark.parametrize("name", CONTROLLERS.names())
@pytest.mark.parametrize("seed", range(3))
def test_any_measurement_gives_a_command_within_the_limit(rig, name, seed):
    random = np.random.default_rng(100 + seed)
    law = make(rig, name)
    for cycle in range(600):
        values = 10.0 ** random.uniform(-20.0, random.choice([2.0, 20.0, 308.0]), 12) * random.choice([-1.0, 1.0], 12)
        if cycle % 3 == 0:
            values[random.integers(12)] = random.choice([math.nan, math.inf, -math.inf, 0.0])
        command = law.step(values[:7], values[7:10], values[10:])
        assert abs(command) <= rig.limits.spool, f"{name}, seed {seed}, cycle {cycle}: {values}"
        assert np.all(np.isfinite(law._memory)), f"{name}, seed {seed}, cycle {cycle}: {values}"
        if cycle % 50 == 49:
            law.reset()


@pytest.mark.parametrize("name", CONTROLLERS.names())
def test_a_broken_cycle_is_forgotten(rig, name):
    """One cycle of NaN in the middle of a run: afterwards the rig converges to the same state as without it."""
    wanted = np.array([2.7e3 if CONTROLLERS.load(name).FOLLOWS == "force" else 1e-3, 0.0, 0.0])
    ends = []
    for broken_cycle in (300, None):
        law, simulator, estimator = make(rig, name), Simulator(rig, PERIOD), FrictionEstimator("gms", rig, PERIOD)
        for k in range(1500):
            measured = measure(rig, simulator)
            friction = estimator.update(measured[sensors.VELOCITY])
            command = law.step(np.full(7, math.nan) if k == broken_cycle else measured, wanted, friction)
            simulator.advance(command, 0.0, 0.0, 0.0, 0.0)
        assert np.all(np.isfinite(law._memory))
        ends.append([command, simulator.y[X], simulator.y[PL]])
    assert ends[0][0] == pytest.approx(ends[1][0], abs=1e-8)
    assert ends[0][1:] == pytest.approx(ends[1][1:], rel=1e-3)


@pytest.mark.parametrize("name", CONTROLLERS.names())
def test_what_a_law_does_not_need_it_does_without(rig, name):
    needs = CONTROLLERS.load(name).NEEDS
    whole, blind = make(rig, name), make(rig, name)
    wanted = np.array([2.7e3 if CONTROLLERS.load(name).FOLLOWS == "force" else 1e-3, 0.0, 0.0])
    simulator, estimator, commands = Simulator(rig, PERIOD), FrictionEstimator("gms", rig, PERIOD), []
    for _ in range(300):
        measured = measure(rig, simulator)
        partial = np.array([value if signal in needs else math.nan for signal, value in zip(SENSED, measured, strict=True)])
        friction = estimator.update(measured[sensors.VELOCITY])
        commands.append((whole.step(measured, wanted, friction), blind.step(partial, wanted, friction)))
        simulator.advance(commands[-1][0], 0.0, 0.0, 0.0, 0.0)
    given, without = np.array(commands).T
    assert np.max(np.abs(given)) > 1e-5
    assert without == pytest.approx(given, abs=1e-12)


FORCE_LAWS = {
    "fasmc": {},
    "sic": {},
    "fasmc_output_feedback": {"coupling_stiffness": 0.0, "coupling_damping": 0.0},
    "fasmc, retuned": {"k": 24.0, "g": 120.0},
}
SWITCH, AFTER = 2310, 200


class Switched(Bench):
    """The same loop, in which a second controller follows the first one, and takes over at a cycle."""

    def __init__(self, rig: Any, law: Controller, coming: Controller) -> None:
        super().__init__(rig, law)
        self.coming, self.command = coming, 0.0
        leaving = law.step

        def step(measured: np.ndarray, reference: np.ndarray, friction: np.ndarray) -> float:
            seen = measured, reference, friction
            if self.cycle <= SWITCH:
                shadow = coming.follow(*seen, self.command)
                self.command = shadow if self.cycle == SWITCH else leaving(*seen)
            else:
                self.command = coming.step(*seen)
            return self.command

        law.step = step  # type: ignore[method-assign]


def traces(bench: Bench) -> tuple[np.ndarray, np.ndarray]:
    """Return force error [N] and command [m] of each cycle."""
    steps = [bench.step() for _ in range(SWITCH + AFTER)]
    return np.array([m[sensors.FORCE] - r[0] for m, r, _ in steps]), np.array([command for _, _, command in steps])


def named(rig: Any, name: str) -> Controller:
    return make(rig, name.partition(",")[0], **FORCE_LAWS[name])


@pytest.fixture(scope="module")
def alone(rig: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return {name: traces(Bench(rig, named(rig, name))) for name in FORCE_LAWS}


@pytest.mark.parametrize(("first", "second"), list(permutations(FORCE_LAWS, 2)))
def test_a_switch_of_controllers_makes_no_bump(rig, alone, first, second):
    errors, commands = traces(Switched(rig, named(rig, first), named(rig, second)))
    after = slice(SWITCH, SWITCH + AFTER)
    # Before the switch the second law does not affect the loop. After it the error is that of the two laws, which have
    # different histories there: an integral, such as that of sic, has another value.
    assert np.array_equal(commands[:SWITCH], alone[first][1][:SWITCH])
    usual = max(np.max(np.abs(alone[name][0][after])) for name in (first, second))
    assert np.max(np.abs(errors[after])) <= 1.2 * usual
    # The command continues from the last one; the new law's immediate reaction to the error is small.
    assert np.max(np.abs(np.diff(commands[SWITCH - 1 : SWITCH + 5]))) <= 0.01 * rig.limits.spool


@pytest.mark.parametrize("name", CONTROLLERS.names())
def test_one_that_follows_its_like_commands_the_same(rig, name):
    law, shadow = make(rig, name), make(rig, name)
    wanted = np.array([2.7e3 if CONTROLLERS.load(name).FOLLOWS == "force" else 1e-3, 0.0, 0.0])
    simulator, estimator, command = Simulator(rig, PERIOD), FrictionEstimator("gms", rig, PERIOD), 0.0
    for _ in range(300):
        measured = measure(rig, simulator)
        friction = estimator.update(measured[sensors.VELOCITY])
        followed = shadow.follow(measured, wanted, friction, command)
        command = law.step(measured, wanted, friction)
        # fasmc passes the effect of a predecessor's adapted alpha and beta on to D.
        assert followed == pytest.approx(command, rel=1e-3, abs=1e-7)
        simulator.advance(command, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", CONTROLLERS.names())
def test_what_another_commands_leaves_nothing_wrong_in_a_law(rig, name):
    random, law = np.random.default_rng(7), make(rig, name)
    for cycle in range(600):
        values = 10.0 ** random.uniform(-20.0, random.choice([2.0, 20.0, 308.0]), 12) * random.choice([-1.0, 1.0], 12)
        command = law.follow(values[:7], values[7:10], values[10:], random.uniform(-1.0, 1.0) * rig.limits.spool)
        assert abs(command) <= rig.limits.spool, f"{name}, cycle {cycle}: {values}"
        assert np.all(np.isfinite(law._memory)), f"{name}, cycle {cycle}: {values}"
