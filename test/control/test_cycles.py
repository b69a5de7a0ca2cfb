"""Snapshot, reference and friction estimate of one cycle are matched in any order of arrival and with any delay."""

import itertools

import pytest

from ehls_ros.control.cycles import KEPT, Cycles

PATIENCE = 0.005
PERIOD = 0.001
AHEAD = 200


def measured(cycle, run=0):
    return tuple(run + cycle + i / 10 for i in range(7))


def reference(cycle):
    return (float(cycle), 1.0, 2.0)


def friction(cycle, run=0):
    return (run + 100.0 + cycle, 3.0)


def make(*, references=AHEAD, uses_friction=True):
    """Return a controller's cycles with the references of the first ones."""
    cycles = Cycles(friction=uses_friction, patience=PATIENCE)
    for cycle in range(references):
        cycles.add_reference(cycle, reference(cycle))
    return cycles


def snapshot(cycles, cycle, now=0.0, run=0):
    cycles.add_snapshot(cycle, 1000 * cycle, measured(cycle, run), now)


def answer(cycles, cycle, now=0.0, run=0):
    """Deliver all inputs of a cycle, and return the answer."""
    snapshot(cycles, cycle, now, run)
    cycles.add_friction(cycle, friction(cycle, run))
    return cycles.take(now)


def test_a_cycle_is_answered_with_what_is_its_own():
    cycles = make()
    for cycle in range(50):
        ready = answer(cycles, cycle)
        assert ready == (cycle, 1000 * cycle, measured(cycle), reference(cycle), friction(cycle), 1, False)
        assert cycles.take(0.0) is None


def test_a_loop_waits_for_the_message_that_comes_last():
    cycles = make()
    assert cycles.lacks == "friction"
    snapshot(cycles, 0)
    assert cycles.lacks == "estimate"
    assert cycles.take(0.0) is None
    cycles.add_friction(0, friction(0))
    assert cycles.take(0.0).cycle == 0
    assert cycles.lacks == "friction"
    # The estimate may overtake its snapshot.
    cycles.add_friction(1, friction(1))
    assert cycles.lacks == "snapshot"
    assert cycles.take(0.0) is None
    snapshot(cycles, 1)
    assert cycles.take(0.0).friction == friction(1)


def test_without_friction_no_estimate_is_waited_for_or_used():
    cycles = make(uses_friction=False)
    assert cycles.lacks == "snapshot"
    cycles.add_friction(0, friction(0))
    assert not cycles.friction_comes
    snapshot(cycles, 0)
    assert cycles.take(0.0).friction is None


def test_the_reference_is_asked_for_only_where_it_is_not_there():
    cycles = make(references=2)
    assert not cycles.lacks_reference
    for cycle in range(2):
        snapshot(cycles, cycle)
        assert not cycles.lacks_reference
        cycles.add_friction(cycle, friction(cycle))
        cycles.take(0.0)
    snapshot(cycles, 2, now=1.0)
    cycles.add_friction(2, friction(2))
    assert cycles.lacks_reference
    assert cycles.lacks == "reference"
    # There is no deadline: without a reference there is nothing to follow.
    assert cycles.take(1000.0) is None
    assert cycles.waited(1000.0) == 999.0
    cycles.add_reference(2, reference(2))
    assert not cycles.lacks_reference
    assert cycles.take(1000.0).reference == reference(2)
    assert cycles.waited(2000.0) == 0.0


def test_the_newest_complete_cycle_is_answered_and_older_ones_never():
    cycles = make()
    answer(cycles, 0)
    for cycle in range(1, 6):
        snapshot(cycles, cycle)
    for cycle in range(1, 4):
        cycles.add_friction(cycle, friction(cycle))
    ready = cycles.take(0.0)
    assert (ready.cycle, ready.elapsed, ready.friction) == (3, 3, friction(3))
    assert cycles.take(0.0) is None
    cycles.add_friction(5, friction(5))
    ready = cycles.take(0.0)
    assert (ready.cycle, ready.elapsed) == (5, 2)
    cycles.add_friction(4, friction(4))
    assert cycles.take(1000.0) is None
    assert cycles.waited(1000.0) == 0.0
    # A later run does not find their inputs either.
    snapshot(cycles, 4)
    assert cycles.lacks_reference


def test_a_controller_that_joins_late_begins_with_the_newest_cycle():
    cycles = make(references=0)
    for cycle in range(1000):
        snapshot(cycles, cycle)
        cycles.add_reference(cycle, reference(cycle))
        cycles.add_friction(cycle, friction(cycle))
    ready = cycles.take(0.0)
    assert (ready.cycle, ready.elapsed, ready.anew) == (999, 1, False)
    assert cycles.take(0.0) is None


def test_an_estimate_that_stays_away_is_waited_for_once():
    cycles = make()
    answer(cycles, 0)
    snapshot(cycles, 1, now=1.0)
    assert cycles.take(1.0 + PATIENCE) is None
    assert cycles.friction_comes
    ready = cycles.take(1.0 + 1.001 * PATIENCE)
    assert (ready.cycle, ready.friction, ready.elapsed) == (1, None, 1)
    assert not cycles.friction_comes
    assert cycles.lacks == "snapshot"
    # From now on a cycle proceeds without it at once.
    snapshot(cycles, 2, now=2.0)
    assert cycles.take(2.0).friction is None
    # A late estimate is useless to its cycle, but the next cycle waits again.
    cycles.add_friction(2, friction(2))
    assert cycles.friction_comes
    assert cycles.take(2.0) is None
    snapshot(cycles, 3, now=3.0)
    assert cycles.take(3.0) is None
    cycles.add_friction(3, friction(3))
    assert cycles.take(3.0).friction == friction(3)


def test_patience_is_counted_from_the_oldest_snapshot_of_a_plant_that_waits_for_nobody():
    cycles, answers = make(), []
    for cycle in range(100):
        now = (cycle + 1) * PERIOD
        snapshot(cycles, cycle, now)
        if (ready := cycles.take(now)) is not None:
            answers.append((now, ready.cycle))
    first, cycle = answers[0]
    assert first - PERIOD == pytest.approx(PATIENCE + PERIOD)
    # The newest cycle is answered, and from there on each one at once.
    assert cycle == round(first / PERIOD) - 1
    assert [after - before for (_, before), (_, after) in itertools.pairwise(answers)] == [1] * (len(answers) - 1)


def test_patience_is_counted_anew_after_an_answer():
    cycles = make()
    snapshot(cycles, 0, now=0.0)
    snapshot(cycles, 1, now=0.9 * PATIENCE)
    cycles.add_friction(0, friction(0))
    assert cycles.take(0.9 * PATIENCE).cycle == 0
    assert cycles.take(1.8 * PATIENCE) is None
    assert cycles.waited(1.8 * PATIENCE) == pytest.approx(0.9 * PATIENCE)
    assert cycles.take(2.0 * PATIENCE).friction is None


def test_a_plant_that_begins_anew_is_answered_from_its_first_cycle():
    cycles = make()
    for cycle in range(100):
        answer(cycles, cycle)
    # Sent before the plant ended, and never answered.
    snapshot(cycles, 101)
    cycles.add_friction(101, friction(101))
    cycles.add_reference(101, reference(101))
    snapshot(cycles, 150)
    for cycle in range(160):
        cycles.add_reference(cycle, reference(cycle))
    ready = answer(cycles, 0, run=5000)
    assert (ready.cycle, ready.elapsed, ready.anew, ready.measured) == (0, 1, True, measured(0, 5000))
    for cycle in range(1, 160):
        ready = answer(cycles, cycle, run=5000)
        assert ready[:6] == (cycle, 1000 * cycle, measured(cycle, 5000), reference(cycle), friction(cycle, 5000), 1)
        assert not ready.anew


def test_an_estimate_of_an_earlier_run_is_not_taken_for_one_of_this():
    cycles = make()
    for cycle in range(10):
        answer(cycles, cycle)
    # It answers a cycle that this controller never received.
    cycles.add_friction(20, friction(20))
    for cycle in range(21):
        cycles.add_reference(cycle, reference(cycle))
        snapshot(cycles, cycle, now=1.0, run=5000)
        if cycle < 15:
            cycles.add_friction(cycle, friction(cycle, 5000))
        ready = cycles.take(1.0 + 2.0 * PATIENCE)
        assert ready.friction == (friction(cycle, 5000) if cycle < 15 else None)


def test_a_cycle_that_comes_again_is_a_plant_that_began_anew():
    cycles = make()
    answer(cycles, 0)
    cycles.add_reference(0, reference(0))
    ready = answer(cycles, 0, run=5000)
    assert (ready.cycle, ready.elapsed, ready.anew, ready.measured) == (0, 1, True, measured(0, 5000))
    # Of two unanswered ones, the later counts, and its patience starts with it.
    snapshot(cycles, 1, now=1.0)
    snapshot(cycles, 1, now=2.0, run=5000)
    assert cycles.take(2.0 + PATIENCE) is None
    cycles.add_friction(1, friction(1))
    ready = cycles.take(2.0)
    assert (ready.measured, ready.anew) == (measured(1, 5000), False)


@pytest.mark.parametrize("step", [1, 3])
def test_what_is_kept_does_not_grow_with_the_run(step):
    cycles = make(references=0)
    for cycle in range(3 * KEPT):
        cycles.add_reference(cycle + AHEAD, reference(cycle))
        # A second sender, far behind.
        cycles.add_reference(max(cycle - AHEAD, 0), reference(cycle))
        cycles.add_friction(cycle, friction(cycle))
        if cycle % step == 0:
            snapshot(cycles, cycle)
            cycles.take(0.0)
    assert cycles.answered >= 3 * KEPT - step
    assert len(cycles._references) <= KEPT
    assert len(cycles._frictions) <= step
    assert len(cycles._pending) <= 1
