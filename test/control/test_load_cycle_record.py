"""The record of a load cycle whose end is not smoothed yet."""

import numpy as np
import pytest

from ehls_ros.control.learning.repetition import PHASE, SMOOTHED, LoadCycle, Recorder

SIZE, LATE = 1000, 90
PERIOD = 1e-3


def second(frequency: float) -> LoadCycle:
    """Return the second of two load cycles with a sine of 1 kN [Hz]; the force at its end is not yet smoothed."""
    recorder, forces = Recorder(), 1e3 * np.sin(2.0 * np.pi * frequency * np.arange(2 * SIZE) * PERIOD)
    for turn in (0, 1):
        recorder.begin(follows=turn > 0)
        rows = recorder.add(turn * SIZE, SIZE)
        rows[:] = 0.0
        rows[:, PHASE] = np.arange(SIZE) / SIZE
        rows[:, SMOOTHED] = np.nan
        recorder.smoothed(0, forces[: (turn + 1) * SIZE - LATE])
    found = recorder.complete()
    assert found is not None
    return found


@pytest.mark.parametrize("frequency", [1.3, 2.5, 0.37, 4.75])
def test_a_force_out_of_step_has_no_step_where_the_load_cycle_before_takes_its_place(frequency: float):
    """It had one of up to twice the force, which a predictive law followed."""
    force = second(frequency).columns[:, SMOOTHED]
    steps = np.abs(np.diff(np.append(force, force[0])))
    own = 1e3 * 2.0 * np.pi * frequency * PERIOD
    # Blended within the late samples: a difference of 2 kN at most, whose slope is at most 1.5 times its mean one.
    allowed = own + 1.5 * (2e3 + own * LATE) / LATE
    assert np.max(steps[: SIZE - 1]) < allowed
    assert np.max(np.abs(np.diff(force, 2))[SIZE - LATE - 10 : SIZE - LATE + 10]) < 0.3 * allowed


def test_a_force_in_step_is_that_of_the_load_cycle_before():
    force = second(2.0).columns[:, SMOOTHED]
    assert force == pytest.approx(1e3 * np.sin(2.0 * np.pi * 2.0 * np.arange(SIZE) * PERIOD), abs=1e-6)
