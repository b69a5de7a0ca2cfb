"""Effects of the valve on the spool, in closed form."""

import math

import numpy as np
import pytest
from rig_runs import PERIOD, run, stage_effects

from ehls_ros.physics.plant import INPUTS, XV
from ehls_ros.physics.simulator import Simulator

OMEGA = 111.46370743


@pytest.fixture
def spool(make_rig):
    """Return the spool at each cycle under given commands, with effects of the valve, from the start on."""

    def follow(commands, period=PERIOD, step=None, **changed):
        rig = make_rig(effects=stage_effects("valve", changed))
        inputs = np.column_stack([commands, np.zeros((len(commands), 2))])
        return run(Simulator(rig, period, step), inputs)[:, XV]

    return follow


def responses(commands, period, delay, step):
    """Sum the responses to the commands' steps, each ``delay`` late, at the cycles."""
    t = np.arange(len(commands) + 1) * period
    sizes = np.diff(commands, prepend=0.0)
    return sum(size * step(np.maximum(t - k * period - delay, 0.0)) for k, size in enumerate(sizes))


def first_order(t):
    return -np.expm1(-OMEGA * t)


def second_order(frequency, damping):
    def step(t):
        # Complex for a damping below 1; the same formula holds above it.
        root = np.emath.sqrt(damping**2 - 1.0)
        slow, fast = frequency * (-damping + root), frequency * (-damping - root)
        return np.real(1.0 + (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (slow - fast))

    return step


@pytest.mark.parametrize("period", [1e-3, 4e-4])
@pytest.mark.parametrize("delay", [0.0, 1e-4, 0.37e-3, 1e-3, 2.6e-3, 12e-3, 0.05])
def test_a_delay_shifts_the_spool_by_the_delay(delay, period, spool):
    commands = 3e-4 * np.random.default_rng(3).standard_normal(200)
    found = spool(commands, period, command_delay={"delay": delay})
    np.testing.assert_allclose(found, responses(commands, period, delay, first_order), rtol=1e-7, atol=1e-12)


def test_only_an_effect_that_looks_back_keeps_commands(make_rig):
    assert Simulator(make_rig()).inputs.size == INPUTS
    late = make_rig(effects=stage_effects("valve", {}))
    assert Simulator(late, 1e-3).inputs.size == INPUTS + 50
    assert Simulator(late, 4e-4).inputs.size == INPUTS + 125


@pytest.mark.parametrize("damping", [0.1, 0.4, 0.7, 1.5])
@pytest.mark.parametrize("frequency", [60.0, 400.0])
def test_a_second_order_spool_has_its_step_response(frequency, damping, spool):
    found = spool(np.full(2000, 2e-4), 1e-4, valve_second_order={"natural_frequency": frequency, "damping": damping})
    t = np.arange(2001) * 1e-4
    np.testing.assert_allclose(found, 2e-4 * second_order(frequency, damping)(t), rtol=1e-6, atol=1e-10)
    if damping < 1.0:
        overshoot = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
        assert found.max() / 2e-4 - 1.0 == pytest.approx(overshoot, rel=1e-2, abs=1e-5)


def test_a_late_command_reaches_the_second_order_spool_late(spool):
    commands = 3e-4 * np.random.default_rng(4).standard_normal(150)
    shape = {"natural_frequency": 250.0, "damping": 0.5}
    found = spool(commands, command_delay={"delay": 3.3e-3}, valve_second_order=shape)
    expected = responses(commands, PERIOD, 3.3e-3, second_order(250.0, 0.5))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-10)


def test_what_stands_before_the_second_order_spool_goes_through_it(spool):
    commands = np.full(100, 5e-4)
    shape = {"natural_frequency": 250.0, "damping": 0.5}
    limited = spool(commands, valve_saturation={"command_limit": 2e-4}, valve_second_order=shape)
    np.testing.assert_allclose(limited, spool(np.full(100, 2e-4), valve_second_order=shape), rtol=1e-12)


def test_hysteresis_loses_its_width_at_each_reversal(spool):
    """Commands held until the spool has come to rest: up, back by less than the width, further back, up again."""
    width = 1e-4
    stops = np.array([5e-4, 4.2e-4, 4.01e-4, 2e-4, 2.9e-4, 4e-4, -6e-4])
    expected = np.array([4.5e-4, 4.5e-4, 4.5e-4, 2.5e-4, 2.5e-4, 3.5e-4, -5.5e-4])
    found = spool(np.repeat(stops, 150), valve_hysteresis={"width": width})
    np.testing.assert_allclose(found[150::150], expected, rtol=1e-6)


def test_plays_in_parallel_round_the_corners_of_the_loop_and_leave_its_width(spool):
    """Narrow plays reverse at once, wide ones late; each alone is equivalent to one play of its width."""
    t = np.arange(3000) * PERIOD
    commands = 4e-4 * np.sin(2.0 * math.pi * 0.7 * t)
    # Small steps, as a play that begins to follow is a bend that no event marks.
    together = spool(commands, step=1e-4, valve_hysteresis={"width": 1e-4, "spread": 0.8})
    single = [spool(commands, step=1e-4, valve_hysteresis={"width": width}) for width in (0.4e-4, 0.8e-4, 1.2e-4, 1.6e-4)]
    np.testing.assert_allclose(together, np.mean(single, axis=0), atol=1e-9)
    assert np.max(np.abs(together - spool(commands, valve_hysteresis={"width": 1e-4}))) > 1e-5


def test_the_loop_of_a_sampled_sine_is_as_wide_as_the_hysteresis(spool):
    """Rising and falling, the spool is half a width behind the command for a slow sine."""
    t = np.arange(4000) * PERIOD
    commands = 4e-4 * np.sin(2.0 * math.pi * 0.5 * t)
    wide, plain = spool(commands, valve_hysteresis={"width": 1e-4}), spool(commands)
    behind = (plain - wide)[2000:]
    rising, falling = behind[1800:1999], behind[800:1200]
    np.testing.assert_allclose(rising, 0.5e-4, rtol=1e-3)
    np.testing.assert_allclose(falling, -0.5e-4, rtol=1e-3)


@pytest.mark.parametrize(
    ("command", "changed", "settled"),
    [
        (3e-4, {"valve_null_bias": {"command": -1e-4}}, 2e-4),
        (-3e-4, {"valve_gain_asymmetry": {"command_positive": 0.5, "command_negative": -0.5}}, -1.5e-4),
        (3e-4, {"valve_saturation": {"command_limit": 1e-4}}, 1e-4),
        # In the order of the list: scaled, shifted, cut off.
        (
            3e-4,
            {
                "valve_gain_asymmetry": {"command_positive": 0.5},
                "valve_null_bias": {"command": -1e-4},
                "valve_saturation": {"command_limit": 3e-4},
            },
            3e-4,
        ),
        (3e-4, {"valve_dead_zone": {"positive": 1e-4}, "valve_null_bias": {"opening": 1e-4}}, 3e-4),
    ],
)
def test_the_spool_settles_where_the_command_sends_it(command, changed, settled, spool):
    assert spool(np.full(300, command), **changed)[-1] == pytest.approx(settled, rel=1e-9)
