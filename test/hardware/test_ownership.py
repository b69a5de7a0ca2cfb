"""Acceptance of the senders of an input."""

import pytest

from ehls_ros.hardware.ownership import MOST_CONTENDERS, REMAINDER, RESTART, SILENT, Ownership, node_of

FIRST, OTHER, RESTARTED = "/ehls/reference_node-10", "/ehls/programme_node-11", "/ehls/reference_node-12"


class Time:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def time():
    return Time()


@pytest.fixture
def ownership(time):
    """An input that its first sender has just taken."""
    taken = Ownership(time)
    assert taken.admits(FIRST)
    return taken


def test_the_first_sender_is_accepted_and_every_other_refused_however_long_it_goes_on(ownership, time):
    for _ in range(1000):
        time.now += 0.01
        assert ownership.admits(FIRST)
        assert not ownership.admits(OTHER)
        assert not ownership.admits(RESTARTED)
    assert ownership.owner == FIRST
    assert ownership.contender in {OTHER, RESTARTED}


def test_silence_alone_gives_the_input_to_nobody_else(ownership, time):
    time.now += 3600.0
    assert ownership.silent
    assert not ownership.admits(OTHER)


def test_a_node_that_was_restarted_goes_on_once_its_former_process_is_silent(ownership, time):
    time.now += 0.9 * RESTART
    assert not ownership.admits(RESTARTED)
    time.now += 0.2 * RESTART
    assert ownership.admits(RESTARTED)
    assert not ownership.admits(FIRST)


def test_once_the_owner_has_left_the_next_to_come_is_accepted(ownership, time):
    ownership.release(OTHER, 10)
    assert not ownership.admits(OTHER)
    ownership.release(FIRST, 20)
    assert ownership.admits(OTHER)
    assert not ownership.admits(RESTARTED)


def test_messages_under_way_when_the_owner_left_do_not_make_it_the_owner_again(ownership, time):
    ownership.release(FIRST, 20)
    assert ownership.admits(FIRST)
    assert ownership.owner is None
    assert ownership.admits(OTHER)
    assert not ownership.admits(FIRST)
    assert ownership.contender is None
    # After reactivation it is a contender like any other.
    time.now += 1.1 * REMAINDER
    assert not ownership.admits(FIRST)
    assert ownership.contender == FIRST


def test_a_message_that_its_sender_sent_before_it_left_gives_it_nothing_however_late_it_is_read(ownership, time):
    assert not ownership.admits(OTHER, 5)
    ownership.release(OTHER, 10)
    ownership.release(FIRST, 20)
    time.now += 100.0 * REMAINDER
    assert not ownership.admits(OTHER, 10)
    assert ownership.owner is None
    assert ownership.contender is None
    # The rows ahead of the former owner count until there is another.
    assert ownership.admits(FIRST, 15)
    assert ownership.owner is None
    assert ownership.admits(FIRST, 21)
    assert ownership.owner == FIRST
    assert not ownership.admits(OTHER, 10)
    assert ownership.contender is None


def test_a_contender_yields_only_once_the_owner_has_gone_on_beside_it(ownership, time):
    """An owner that was killed just before is not heard again, except for messages already under way."""
    ownership.admits(OTHER)
    time.now += 0.9 * REMAINDER
    ownership.admits(FIRST)
    assert not ownership.must_yield(OTHER)
    time.now += 10.0
    ownership.admits(OTHER)
    assert not ownership.must_yield(OTHER)
    for _ in range(20):
        time.now += 0.1 * REMAINDER
        ownership.admits(OTHER)
        ownership.admits(FIRST)
    assert ownership.must_yield(OTHER)


def test_a_contender_that_fell_silent_is_reported_no_more(ownership, time):
    ownership.admits(OTHER)
    time.now += 1.1 * SILENT
    assert ownership.contender is None


def test_unnamed_senders_are_one_sender_and_no_restarted_node():
    time = Time()
    ownership = Ownership(time)
    assert ownership.admits("")
    assert ownership.admits("")
    time.now += 10.0
    assert not ownership.admits(FIRST)


def test_a_sender_with_a_new_name_in_each_message_fills_no_memory(ownership):
    for number in range(10 * MOST_CONTENDERS):
        ownership.admits(f"/other/node-{number}")
    assert len(ownership.contenders) <= MOST_CONTENDERS


@pytest.mark.parametrize(("sender", "node"), [(FIRST, "/ehls/reference_node"), ("slow", "slow"), ("", ""), ("a-b", "a-b")])
def test_the_node_of_a_sender(sender, node):
    assert node_of(sender) == node
