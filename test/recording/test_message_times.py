"""Times of a topic's messages: out of order, set by another clock, or unset; and the clocks of several topics."""

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.message_times import Arrivals, Arrived, Clock, check_clocks

UNIX = 1.764e9
PERIOD = 0.002
REGULAR = PERIOD * np.arange(400)


def arranged(time: np.ndarray, received: np.ndarray = REGULAR, zero: float = UNIX) -> Arrived:
    return Arrivals(time, received, np.arange(len(time)) + 1, zero, "header.stamp", "bag, /t", "'received'").arranged()


def refused(time: np.ndarray, received: np.ndarray = REGULAR, zero: float = UNIX) -> str:
    with pytest.raises(BadInput) as error:
        arranged(time, received, zero)
    assert "or 'received'" in str(error.value)
    return str(error.value)


def stepped(size: float, at: int = 200) -> np.ndarray:
    return REGULAR + np.where(np.arange(400) >= at, size, 0.0)


@pytest.mark.parametrize("size", [0.007, 0.0101, 0.1013, 0.35, 0.7999])
@pytest.mark.parametrize("at", [50, 200, 350])
def test_a_clock_set_back_is_refused_with_message_and_size(size: float, at: int):
    text = refused(stepped(-size, at))
    assert (
        f"header.stamp goes back by {1e3 * (size - PERIOD):.4g} ms from message {at} to {at + 1}, received 2 ms apart" in text
    )
    assert f"its clock was set back by about {1e3 * size:.4g} ms" in text


def test_a_clock_set_back_is_found_in_jitter():
    jitter = np.random.default_rng(1).uniform(-0.4, 0.4, 400) * PERIOD
    assert "from message 200 to 201" in refused(stepped(-0.1013) + jitter, REGULAR + np.abs(jitter))


def test_a_sender_that_starts_again_from_zero_is_refused():
    time = np.concatenate([REGULAR[:300], REGULAR[:100]])
    assert "goes back by 598 ms from message 300 to 301" in refused(time, zero=0.0)


@pytest.mark.parametrize("late_by", [1, 2, 7, 100])
def test_single_late_messages_are_sorted_with_a_remark(late_by: int):
    time = np.insert(np.delete(REGULAR, 150), 150 + late_by, REGULAR[150])
    order, remarks = arranged(time)
    np.testing.assert_allclose(time[order], REGULAR)
    assert remarks == (f"1 messages arrived after later ones, by up to {2 * late_by} ms, and are sorted by header.stamp",)


def test_a_batch_that_arrives_after_a_later_one_is_sorted():
    time = np.concatenate([REGULAR[:100], REGULAR[110:115], REGULAR[100:110], REGULAR[115:]])
    np.testing.assert_allclose(time[arranged(time).order], REGULAR)


def test_neighbours_in_any_order_are_sorted():
    time = REGULAR.reshape(-1, 2)[:, ::-1].ravel()
    np.testing.assert_allclose(time[arranged(time).order], REGULAR)


def test_two_senders_with_different_clocks_are_refused():
    time = REGULAR - np.where(np.arange(400) % 2, 0.1, 0.0)
    assert "header.stamp goes back 200 times in 400 messages, first by 98 ms in message 2" in refused(time)


@pytest.mark.parametrize(
    ("time", "complaint"),
    [
        (
            np.concatenate([[-UNIX], REGULAR[1:]]),
            "header.stamp is 0 s in message 1 and 2025-11-24 16:00:00.002 in message 2, received 2 ms apart",
        ),
        (
            np.concatenate([REGULAR[:-1], [-UNIX]]),
            "header.stamp is 2025-11-24 16:00:00.796 in message 399 and 0 s in message 400",
        ),
        (
            stepped(3.2e8)[:201],
            "header.stamp is 2025-11-24 16:00:00.398 in message 200 and 2036-01-15 08:53:20.400 in message 201",
        ),
        (stepped(-3600.0), "header.stamp is 2025-11-24 16:00:00.398 in message 200 and 2025-11-24 15:00:00.400 in message 201"),
        (np.where(np.arange(400) % 10, REGULAR, -UNIX), "there are 79 such jumps"),
    ],
)
def test_unset_stamps_and_those_of_another_clock_are_named(time: np.ndarray, complaint: str):
    assert complaint in refused(time, REGULAR[: len(time)])


def test_a_pause_of_the_sender_and_an_outage_of_the_network_are_no_jumps():
    pause = np.where(np.arange(400) >= 200, 3600.0, 0.0)
    assert arranged(REGULAR + pause, REGULAR + pause).remarks == ()
    late = np.maximum(REGULAR, np.where(np.arange(400) >= 200, 100.0, 0.0))
    assert arranged(REGULAR, late).remarks == ()


def test_a_step_ahead_is_a_remark():
    [remark] = arranged(stepped(0.1013)).remarks
    assert remark == (
        "header.stamp steps ahead by 101.3 ms from message 200 to 201, but not the reception: messages were lost, or the clock "
        "was set"
    )


def test_a_time_that_is_not_finite_is_named():
    assert "header.stamp of message 8 is nan" in refused(np.where(np.arange(400) == 7, np.nan, REGULAR))


def clock(first: float, delay: float, *, given: bool = False, source: str = "header.stamp") -> Clock:
    return Clock(source, first, delay, given)


def test_a_topic_since_boot_beside_one_in_unix_time_is_named():
    with pytest.raises(BadInput) as error:
        check_clocks({"/a": clock(57123.4, UNIX), "/b": clock(UNIX, 0.001)}, "bag")
    assert str(error.value) == (
        "bag: its topics have different clocks: /a: header.stamp counts from boot or start (57123.4 s); /b: header.stamp is "
        "Unix time (2025-11-24 16:00:00.000); expected one clock: 'tables: {/a: {name: received}}' in the map, or an offset"
    )


def test_a_topic_of_another_computer_is_named():
    clocks = {"/a": clock(UNIX, 0.001), "/b": clock(UNIX - 300.0, 300.0), "/c": clock(UNIX, 0.0, source="received")}
    with pytest.raises(BadInput) as error:
        check_clocks(clocks, "bag")
    assert "received of /c is 0 ms before its reception and header.stamp of /b is 300 s before its reception" in str(
        error.value
    )
    assert "'tables: {/b: {name: received}}'" in str(error.value)


def test_a_stamp_in_the_future_is_named():
    with pytest.raises(BadInput, match=r"header.stamp of /b is 40 s after its reception .*/b: \{name: received\}"):
        check_clocks({"/a": clock(UNIX, 0.001), "/b": clock(UNIX + 40.0, -40.0)}, "bag")


def test_small_differences_and_intended_ones_are_remarks():
    assert check_clocks({"/a": clock(UNIX, 0.001), "/b": clock(UNIX, 0.02)}, "bag") == []
    [remark] = check_clocks({"/a": clock(UNIX, 0.001), "/b": clock(UNIX, 0.2)}, "bag")
    assert remark.startswith("the clocks of the topics may differ: header.stamp of /a is 1 ms before its reception")
    assert len(check_clocks({"/a": clock(UNIX, 0.0, given=True), "/b": clock(UNIX, 2.0, given=True)}, "bag")) == 1


@pytest.mark.parametrize("recorder", [False, True], ids=["sender", "sender and recorder"])
def test_a_clock_that_was_set_back_twice_is_mended(recorder: bool):
    time = stepped(-0.1013) - np.where(np.arange(400) >= 300, 0.05, 0.0)
    numbers = np.arange(400) + 1
    arrivals = Arrivals(time, time if recorder else REGULAR, numbers, UNIX, "header.stamp", "bag, /t", "'received'")
    mended, remarks = arrivals.mended()
    np.testing.assert_allclose(mended.time, REGULAR, atol=1e-9)
    assert remarks == [
        "header.stamp was set back by 101.3 ms at message 201; this is mended",
        "header.stamp was set back by 50 ms at message 301; this is mended",
    ]
    np.testing.assert_array_equal(mended.arranged().order, np.arange(400))
