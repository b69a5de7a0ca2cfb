import math

import numpy as np
import pytest

from ehls_ros.arrays import in_python
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.plant import FRICTION, V
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.physics.simulator import Simulator

PERIOD = 1e-3


def velocities(seed: int, cycles: int = 4000) -> np.ndarray:
    """A motion through rest, presliding and fast slip."""
    random = np.random.default_rng(seed)
    t = np.arange(cycles) * PERIOD
    frequencies, phases = random.uniform(0.3, 9.0, 3), random.uniform(0.0, 6.0, 3)
    waves = np.sin(2.0 * np.pi * np.outer(frequencies, t) + phases[:, np.newaxis])
    return np.array([0.15, 0.02, 2e-3]) @ waves * np.where(t % 1.0 < 0.2, 0.0, 1.0)


# With so narrow a change of sides the velocities above reach the curve itself.
NARROW = {"stribeck": {"smoothing": 0.025}}


def estimates(rig, name: str, velocity: np.ndarray, **values: float) -> np.ndarray:
    parameters = OBSERVERS.load(name).Parameters(**{**NARROW.get(name, {}), **values})
    estimator = FrictionEstimator(name, rig, PERIOD, parameters)
    return np.array([estimator.update(v).copy() for v in velocity])


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
@pytest.mark.parametrize("amplitude", [1e-3, 2e-4])
def test_the_rigs_own_model_follows_the_friction_inside_the_plant(rig_mapping, model, amplitude):
    """Within the error of the straight line between two velocities; in a sticking contact, the force is unobservable."""
    rig_mapping["friction"]["model"] = model
    rig = rig_from_mapping(rig_mapping, "rig")
    simulator, estimator = Simulator(rig, PERIOD), FrictionEstimator("rig_model", rig, PERIOD)
    elements = rig.friction_law.states(rig.friction)
    force = in_python(rig.friction_law.force)
    true, found = [], []
    for k in range(2000):
        velocity = simulator.y[V]
        estimate = estimator.update(velocity)
        mode = simulator.mode[1:]
        if mode.all() or math.isfinite(rig.friction_law.stiffness(rig.friction)):
            level = rig.friction_level(velocity)
            true.append(force(velocity, 0.0, level, simulator.y[FRICTION : FRICTION + elements], mode, rig.friction))
            found.append(estimate[0] + estimate[1])
        simulator.advance(amplitude * math.sin(2.0 * math.pi * 1.5 * k * PERIOD), 0.0, 0.0, 0.0, 0.0)
    error = np.abs(np.subtract(found, true))
    assert len(true) > 1000
    assert np.ptp(true) > 1000.0
    assert np.sqrt(np.mean(error**2)) < 2e-3 * np.ptp(true)
    assert np.median(error) < 1e-3 * np.ptp(true)


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
@pytest.mark.parametrize("velocity", [0.3, 1e9, -1e300])
def test_it_stays_within_the_level_after_a_long_gap_or_an_absurd_velocity(rig_mapping, model, velocity):
    rig_mapping["friction"]["model"] = model
    rig = rig_from_mapping(rig_mapping, "rig")
    estimator = FrictionEstimator("rig_model", rig, PERIOD)
    most = rig.friction_level(0.0) * (1.0 + 1e-9)
    for v, elapsed in ((0.0, 1), (velocity, 1), (velocity, 50), (-0.1, 50), (0.1, 1)):
        estimate = estimator.update(v, elapsed)
        assert np.all(np.isfinite(estimate[:3]))
        assert abs(estimate[0]) <= most
    for _ in range(5000):
        estimate = estimator.update(0.1)
    assert estimate[0] == pytest.approx(rig.friction_level(0.1), rel=1e-3)


@pytest.mark.parametrize("amplitude", [1e-3, 2e-4, 2e-5])
def test_gms_follows_the_friction_inside_the_plant(rig, amplitude):
    simulator = Simulator(rig, PERIOD)
    estimator = FrictionEstimator("gms", rig, PERIOD)
    wrong = []
    for k in range(4000):
        estimate = estimator.update(simulator.y[V])
        wrong.append(estimate[0] - simulator.y[FRICTION : FRICTION + 3].sum())
        assert estimate[1] == pytest.approx(7265.0 * simulator.y[V])
        simulator.advance(amplitude * math.sin(2.0 * math.pi * 1.5 * k * PERIOD), 0.0, 0.0, 0.0, 0.0)
    error = np.abs(wrong)
    assert np.max(np.abs(simulator.y[FRICTION : FRICTION + 3].sum())) > 100.0
    assert np.max(error) < 5.0
    assert np.sqrt(np.mean(error**2)) < 0.5


@pytest.mark.parametrize("name", OBSERVERS.names())
@pytest.mark.parametrize("seed", range(3))
def test_estimate_is_odd_and_within_static_friction(rig, name, seed):
    velocity = velocities(seed)
    forward, backward = estimates(rig, name, velocity), estimates(rig, name, -velocity)
    elements = (forward.shape[1] - 2) // 2
    assert np.array_equal(forward[:, : 2 + elements], -backward[:, : 2 + elements])
    assert np.array_equal(forward[:, 2 + elements :], backward[:, 2 + elements :])
    assert np.max(np.abs(forward[:, 0])) <= 865.4 * (1.0 + 1e-9)
    assert np.max(np.abs(forward[:, 0])) > 500.0
    assert np.allclose(forward[:, 2 : 2 + elements].sum(axis=1), forward[:, 0], atol=1e-9)
    assert set(np.unique(forward[:, 2 + elements :])) <= {0.0, 1.0}


def test_gms_elements_stay_within_their_shares_and_settle_on_the_curve(rig):
    estimate = estimates(rig, "gms", np.concatenate([velocities(1), np.full(3000, -0.1)]))
    for i, share in enumerate((0.829, 0.089, 0.082)):
        assert np.max(np.abs(estimate[:, 2 + i])) <= share * 865.4 * (1.0 + 1e-9)
        # (9): F_i = sgn(v) alpha_i s(v)
        level = 640.8 + (865.4 - 640.8) * math.exp(-((0.1 / 2.031e-3) ** 0.8764))
        assert estimate[-1, 2 + i] == pytest.approx(-share * level, rel=1e-3)
    assert np.array_equal(estimate[-1, 5:], [1.0, 1.0, 1.0])


def test_gms_at_rest_and_in_presliding_is_a_spring(rig):
    # 0.1 mm at (1884 + 196.9 + 184.1) N/mm; nothing slips before 0.28 mm
    velocity = np.concatenate([np.zeros(5), np.full(101, 1e-3), np.zeros(50)])
    estimate = estimates(rig, "gms", velocity)
    assert np.array_equal(estimate[:5], np.zeros((5, 8)))
    way = np.sum(0.5 * (velocity[1:] + velocity[:-1])) * PERIOD
    assert estimate[-1, 0] == pytest.approx(2265.0e3 * way, rel=1e-9)
    assert np.array_equal(estimate[-1, 5:], np.zeros(3))


@pytest.mark.parametrize("smoothing", [2.031e-3, 0.025, 0.2])
def test_stribeck_is_the_smoothed_curve(rig, smoothing):
    for v in (-0.15, -2.031e-3, -1e-5, 0.0, 3e-4, 2.031e-3, 0.02, 0.4):
        level = 640.8 + 224.6 * math.exp(-((abs(v) / 2.031e-3) ** 0.8764))
        estimate = estimates(rig, "stribeck", np.array([v]), smoothing=smoothing)[0]
        assert estimate[0] == pytest.approx(level * math.tanh(v / smoothing), rel=1e-12, abs=1e-12)
        assert estimate[1] == pytest.approx(7265.0 * v)


def test_gms_converges_with_its_steps(rig):
    velocity = velocities(4, 1500)
    runs = {steps: estimates(rig, "gms", velocity, steps=steps)[:, 0] for steps in (1, 4, 100)}
    assert 1e-6 < np.max(np.abs(runs[1] - runs[100])) < 1.0
    assert np.max(np.abs(runs[4] - runs[100])) < 0.1 * np.max(np.abs(runs[1] - runs[100]))


@pytest.mark.parametrize("name", OBSERVERS.names())
@pytest.mark.parametrize("cycles", [2, 7, 50])
def test_an_update_after_a_gap_is_that_of_the_longer_period(rig, name, cycles):
    late, slow = FrictionEstimator(name, rig, PERIOD), FrictionEstimator(name, rig, cycles * PERIOD)
    for v in velocities(2, 2000)[::cycles]:
        assert late.update(v, cycles).tobytes() == slow.update(v).tobytes()
    # The cycle after a gap is a regular one.
    usual = FrictionEstimator(name, rig, PERIOD)
    for kept, from_gap in zip(usual.state, late.state, strict=True):
        kept[:] = from_gap
    assert late.update(0.03).tobytes() == usual.update(0.03).tobytes()


@pytest.mark.parametrize("cycles", [1, 5, 30])
def test_gms_sticks_over_a_gap_as_a_spring_does(rig, cycles):
    estimator = FrictionEstimator("gms", rig, PERIOD)
    estimator.update(2e-3)
    # On average 3 mm/s for the time of the gap, at 2265 N/mm: at most 0.09 mm, and nothing slips before 0.28 mm.
    assert estimator.update(4e-3, cycles)[0] == pytest.approx(2265e3 * 3e-3 * cycles * PERIOD, rel=1e-9)


@pytest.mark.parametrize("name", OBSERVERS.names())
def test_reset_puts_it_at_rest(rig, name):
    estimator = FrictionEstimator(name, rig, PERIOD)
    first = np.array([estimator.update(v).copy() for v in velocities(0, 500)])
    estimator.reset()
    assert np.array_equal(first, np.array([estimator.update(v).copy() for v in velocities(0, 500)]))
    assert len(estimator.element_forces) == len(estimator.slipping)


@pytest.mark.parametrize("name", OBSERVERS.names())
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_velocity_that_is_no_number_leaves_no_trace(rig, name, bad):
    velocity = velocities(1, 1000)
    with_gaps = velocity.copy()
    with_gaps[[0, 400, 401, 999]] = bad
    velocity[[0, 400, 401, 999]] = 0.0, velocity[399], velocity[399], velocity[998]
    assert np.array_equal(estimates(rig, name, with_gaps), estimates(rig, name, velocity))


def test_a_rig_with_another_number_of_elements_works(rig):
    friction = rig.friction._replace(element_stiffness=(2e6, 1e5), element_weight=(0.7, 0.3))
    estimator = FrictionEstimator("gms", rig._replace(friction=friction), PERIOD)
    for _ in range(2000):
        estimate = estimator.update(0.05)
    assert estimate.shape == (6,)
    assert estimate[0] == pytest.approx(640.8, rel=1e-2)
