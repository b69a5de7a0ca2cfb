"""Arrival times scatter; the evenly spaced sending times are reconstructed from them."""

import numpy as np
import pytest

from ehls_ros.recording.times import sent_evenly

PERIOD = 1e-3


def sent(lost=(), count=6000, drift=3e-5):
    """Return the times of messages sent every millisecond by a clock that drifts, some of them lost."""
    return PERIOD * (1.0 + drift) * np.setdiff1d(np.arange(count), lost)


def received(times, scatter, seed=0):
    """Return their arrival times, in order, after delays with this mean and spread."""
    return np.maximum.accumulate(times + scatter * np.random.default_rng(seed).exponential(1.0, len(times)))


@pytest.mark.parametrize("lost", [(), (700, 1500, 1501, 1502, 4000)])
def test_scattered_times_become_even_again_and_lost_messages_stay_lost(lost):
    times = sent(lost)
    even = sent_evenly(received(times, 1e-4))
    # Except for the mean delay, which is unobservable.
    np.testing.assert_allclose(even - times, 1e-4, atol=3e-5)


def test_a_stall_delays_messages_without_losing_any():
    times = sent()
    late = times + 1e-5
    late[3000:3005] = late[3005]
    even = sent_evenly(late)
    np.testing.assert_allclose(even - times, 1e-5, atol=1e-5)


def test_what_was_not_sent_evenly_is_left_as_it_is():
    rng = np.random.default_rng(1)
    assert sent_evenly(np.cumsum(rng.exponential(PERIOD, 6000))) is None
    assert sent_evenly(received(sent(), 3.0 * PERIOD)) is None
    assert sent_evenly(sent(count=50)) is None
