"""Header stamps are evenly spaced, and never depart from the clock for good."""

import numpy as np
import pytest

from ehls_ros.hardware.stamps import FAR, Stamps

PERIOD_NS = 1_000_000
START_NS = 1_700_000_000_000_000_000
"""A time of the system's clock."""


@pytest.fixture
def stamps() -> Stamps:
    begun = Stamps(1e-3)
    begun.begin(7, START_NS)
    return begun


def test_they_are_even_though_the_cycles_are_not(stamps):
    late = np.random.default_rng(1).integers(0, 20 * PERIOD_NS, 1000)
    given = [stamps.of(7 + k, START_NS + k * PERIOD_NS + int(late[k])) for k in range(1000)]
    assert given == [START_NS + k * PERIOD_NS for k in range(1000)]
    assert stamps.jumps == 0


@pytest.mark.parametrize("slept_s", [8.0, -3600.0])
def test_after_a_sleep_or_a_set_clock_they_are_the_clocks_again(stamps, slept_s):
    stamps.of(8, START_NS + PERIOD_NS)
    now_ns = START_NS + round(slept_s * 1e9)
    assert stamps.of(9, now_ns) == now_ns
    assert (stamps.jumps, stamps.behind) == (1, 0.0)
    assert stamps.jump == pytest.approx(slept_s, abs=0.01)
    assert stamps.of(10, now_ns + PERIOD_NS) == now_ns + PERIOD_NS
    assert stamps.jumps == 1


def test_what_they_lag_in_small_steps_is_told_and_made_up_for(stamps):
    for k in range(1, 2000):
        stamp_ns = stamps.of(7 + k, START_NS + 2 * k * PERIOD_NS)
        assert abs(START_NS + 2 * k * PERIOD_NS - stamp_ns) < FAR * 1e9
    assert stamps.jumps == 1
    assert 0.0 < stamps.figures()["stamps_behind_s"] < FAR


def test_without_a_clock_they_count_on(stamps):
    assert stamps.of(1007, None) == START_NS + 1000 * PERIOD_NS
    # use_sim_time: time starts with the first clock message.
    assert stamps.of(1008, 42) == 42
