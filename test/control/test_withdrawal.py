"""A correction that increases the force error is withdrawn, and returns at ever longer intervals."""

import numpy as np

from ehls_ros.control.learning.learnt_block import MAX_ERROR_RATIO, MAX_WAIT, WAIT, WITHDRAWAL_MARGIN, Withdrawal

SIZE = 100
ERROR = 10.0 * np.sin(2.0 * np.pi * np.arange(SIZE) / SIZE)


def known() -> Withdrawal:
    """Return a withdrawal that has seen the error without correction twice."""
    withdrawal = Withdrawal(SIZE)
    withdrawal.observe(ERROR)
    withdrawal.observe(ERROR)
    return withdrawal


def test_nothing_is_withdrawn_before_the_error_without_correction_is_known():
    withdrawal = Withdrawal(SIZE)
    assert not withdrawal.exceeds(1e12, SIZE)
    assert not withdrawal.is_worse(1e6 * ERROR)


def test_a_load_cycle_may_run_ahead_of_those_without_correction_by_the_margin():
    withdrawal, squares = known(), np.cumsum(ERROR**2)
    for samples in (1, 30, SIZE):
        allowed = squares[samples - 1] + WITHDRAWAL_MARGIN * squares[-1]
        assert not withdrawal.exceeds(0.99 * allowed, samples)
        assert withdrawal.exceeds(1.01 * allowed, samples)


def test_a_load_cycle_with_a_larger_error_did_harm_and_one_with_a_smaller_did_not():
    withdrawal = known()
    assert withdrawal.is_worse(1.01 * MAX_ERROR_RATIO * ERROR)
    assert not withdrawal.is_worse(0.99 * ERROR)


def test_a_correction_stays_away_twice_as_long_each_time_and_comes_back_sooner_after_it_has_proved_good():
    withdrawal = known()
    waits = []
    for _ in range(6):
        withdrawal.withdraw()
        waits.append(withdrawal.waiting)
        for left in range(withdrawal.waiting - 1, -1, -1):
            withdrawal.observe(ERROR)
            assert withdrawal.waiting == left
    assert waits == [WAIT, 2 * WAIT, 4 * WAIT, 8 * WAIT, MAX_WAIT, MAX_WAIT]
    for _ in range(2**7):
        assert not withdrawal.is_worse(0.1 * ERROR)
    withdrawal.withdraw()
    assert withdrawal.waiting == WAIT


def test_a_transient_does_not_count_as_the_error_without_correction():
    withdrawal = Withdrawal(SIZE)
    withdrawal.observe(100.0 * ERROR)
    withdrawal.observe(ERROR)
    assert not withdrawal.repeats
    assert withdrawal.is_worse(2.0 * ERROR)
    withdrawal.observe(1.1 * ERROR)
    assert withdrawal.repeats
