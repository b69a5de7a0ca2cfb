"""The udp backend and the target's side of the protocol, over real sockets on this host."""

import contextlib
import math
import socket
import time

import pytest
from patience import PATIENCE
from udp_link import PERIOD, UDP, VALUES, WIRING, TargetEnd, greeted, opened

from ehls_ros.errors import BadInput
from ehls_ros.hardware.packet import Codec, Kind, Packet, Status

WATCHDOG = 0.01


@pytest.fixture
def end():
    made = TargetEnd()
    with made.socket:
        yield made


@pytest.fixture
def device(end):
    with contextlib.closing(opened(end)) as made:
        greeted(end, made)
        yield made


@pytest.fixture
def stranger():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        yield made


def address_of(end):
    return end.target.address


def test_reading_has_the_wired_channels(end, device):
    end.measure(7, status=Status.WATCHDOG)
    reading = device.read(PATIENCE)
    assert reading[:4] == (7, 7000, (VALUES[2], VALUES[0]), True)
    end.measure(8)
    assert not device.read(PATIENCE).at_null


@pytest.mark.parametrize(("asked", "sent"), [(1.25, 1.25), (7.0, 5.0), (-1e30, -5.0), (math.nan, 0.5), (math.inf, 0.5)])
def test_command_arrives_within_the_range(end, device, asked, sent):
    end.measure(0)
    device.read(PATIENCE)
    device.write(asked, 0)
    end.take(now=3.0)
    assert end.target.output(3.0) == (sent, Status.COMMANDED)
    assert end.target.answered == 0


def test_nothing_comes_within_the_timeout(device):
    start = time.monotonic()
    assert device.read(0.05) is None
    assert time.monotonic() - start >= 0.05


def test_newest_is_taken_and_gaps_are_counted(end, device):
    for cycle in (0, 1, 4):
        end.measure(cycle)
    assert device.read(PATIENCE).sequence == 4
    figures = device.figures()
    assert (figures["received"], figures["skipped"], figures["lost"]) == (3, 2, 2)


def test_doubled_and_overtaken_packets_are_refused(end, device):
    early = end.target.measurement(4, 0, Status.COMMANDED, VALUES)
    twice = end.measure(5)
    assert device.read(PATIENCE).sequence == 5
    for data in (early, twice):
        end.socket.sendto(data, address_of(end))
    assert device.read(0.02) is None
    assert device.figures()["order"] == 2


def test_stranger_is_refused(end, device, stranger):
    data = end.target.measurement(3, 0, Status.COMMANDED, VALUES)
    stranger.sendto(data, address_of(end))
    assert device.read(0.02) is None
    assert device.figures()["stranger"] == 1
    end.measure(3)
    assert device.read(PATIENCE).sequence == 3


def test_recording_of_an_earlier_run_is_refused(end):
    with contextlib.closing(opened(end)) as first:
        greeted(end, first)
        recorded = [end.measure(cycle) for cycle in range(3)]
        address = address_of(end)
        local_port = address[1]
    end.restart()
    with contextlib.closing(opened(end, local_port=local_port)) as second:
        greeted(end, second)
        for data in recorded:
            end.socket.sendto(data, address)
        assert second.read(0.02) is None
        assert second.figures()["session"] == 3


def test_restarted_target_is_found_again(end, device):
    end.measure(500)
    before = device.read(PATIENCE)
    assert before.sequence == 500
    old = end.target.measurement(501, 0, Status.COMMANDED, VALUES)
    end.restart()
    greeted(end, device)
    end.measure(0)
    after = device.read(PATIENCE)
    assert after.sequence == 0
    assert after.session != before.session
    end.socket.sendto(old, address_of(end))
    assert device.read(0.02) is None
    device.write(1.0, 0)
    end.take()
    assert end.target.output(0.0) == (1.0, Status.COMMANDED)
    assert device.figures()["targets"] == 2


def test_packet_with_too_few_channels_is_refused(end, device):
    end.measure(0, values=(1.0, 2.0))
    assert device.read(0.02) is None
    assert device.figures()["channels"] == 1


@pytest.mark.parametrize("key", ["", "another secret"])
def test_another_key_is_refused(key):
    end = TargetEnd(b"the secret")
    with end.socket, contextlib.closing(opened(end, key=key)) as device:
        assert device.read(0.03) is None
        end.take()
        assert end.target.address is None
        assert end.target.figures()["refused_tag"] >= 1


def test_shared_key_is_accepted():
    end = TargetEnd(b"the secret")
    with end.socket, contextlib.closing(opened(end, key="the secret")) as device:
        greeted(end, device)
        end.measure(0)
        assert device.read(PATIENCE).sequence == 0


def test_flood_does_not_block_the_reader(end, device, monkeypatch):
    monkeypatch.setattr(UDP, "MAX_AT_ONCE", 10)
    for _ in range(50):
        end.socket.sendto(b"noise", address_of(end))
    for taken in (10, 20, 30, 40, 50):
        assert device.read(0.0) is None
        assert device.figures()["refused_length"] == taken
    end.measure(1)
    assert device.read(PATIENCE).sequence == 1


def test_close_commands_null(end):
    device = opened(end)
    greeted(end, device)
    end.measure(0)
    device.read(PATIENCE)
    device.write(4.0, 0)
    device.close()
    device.close()
    end.take(now=1.0)
    assert end.target.output(1.0) == (WIRING.null, Status.COMMANDED)


def test_nothing_is_commanded_before_the_target_answers(end):
    with contextlib.closing(opened(end)) as device:
        device.write(4.0, 0)
        end.take()
        assert end.seen == []


# --- the target's watchdog --------------------------------------------------------------------------------------------


def test_watchdog_goes_to_null_and_back(end, device):
    assert end.target.output(100.0) == (WIRING.null, Status.WAITING)
    end.measure(0)
    device.read(PATIENCE)
    device.write(2.0, 0)
    end.take(now=5.0)
    assert end.target.output(5.0 + WATCHDOG) == (2.0, Status.COMMANDED)
    for late in (1.001, 2.0, 50.0):
        assert end.target.output(5.0 + late * WATCHDOG) == (WIRING.null, Status.WATCHDOG)
    assert end.target.figures()["watchdog"] == 1
    for raw, expected in ((3.0, Status.WATCHDOG), (WIRING.null, Status.COMMANDED), (3.0, Status.COMMANDED)):
        device.write(raw, 0)
        end.take(now=6.0)
        assert end.target.output(6.0) == (WIRING.null if expected == Status.WATCHDOG else raw, expected)


def test_commands_that_are_doubled_overtaken_or_late_are_refused(end, device):
    end.measure(0)
    device.read(PATIENCE)
    device.write(1.0, 0)
    end.take(now=1.0)
    command, sender = end.seen[-1]
    end.target.receive(command, sender, 1.5, 1)
    device.write(2.0, 0)
    end.take(now=2.0, cycle=round(WATCHDOG / PERIOD) + 1)
    device.write(3.0, 99)
    end.take(now=3.0, cycle=20)
    figures = end.target.figures()
    assert (figures["commands"], figures["order"], figures["late"], figures["session"]) == (1, 1, 1, 1)
    assert end.target.output(1.0) == (1.0, Status.COMMANDED)


@pytest.mark.parametrize(("pause", "reason"), [(0.9 * WATCHDOG, "commands"), (1.5 * WATCHDOG, "late"), (0.3, "late")])
def test_age_of_a_command_counts_by_the_clock_of_a_target_that_was_held_up(end, device, pause, reason):
    for cycle in range(5):
        end.measure(cycle, now=5.0 + cycle * PERIOD)
        device.read(PATIENCE)
    device.write(1.0, 4)
    # It stalls between measurement 4 and the next cycle, in which it takes the command.
    end.take(now=5.0 + 4 * PERIOD + pause, cycle=4)
    assert end.target.figures()[reason] == 1
    assert (end.target.answered == 4) == (reason == "commands")


def test_answer_to_a_measurement_that_was_never_sent_is_late(end, device):
    end.measure(7, now=5.0)
    device.read(PATIENCE)
    device.write(1.0, 6)
    end.take(now=5.0, cycle=7)
    assert end.target.figures()["late"] == 1


def test_commands_of_strangers_and_of_earlier_runs_are_refused(end, device, stranger):
    end.measure(0)
    device.read(PATIENCE)
    device.write(1.0, 0)
    [(command, sender)] = list(end.waiting())
    end.target.receive(command, stranger.getsockname(), 1.0, 0)
    session, peer = Codec().parse(command)[1:3]
    forged = Packet(Kind.COMMAND, session, peer ^ 2, 9, 0, 0, 10_000, 0, (5.0,))
    end.target.receive(Codec().pack(forged), sender, 1.0, 0)
    end.restart()
    greeted(end, device)
    end.target.receive(command, sender, 1.0, 0)
    assert end.target.figures()["session"] == 1
    assert end.target.output(1.0) == (WIRING.null, Status.WAITING)


def test_second_computer_waits_until_the_first_is_silent(end, device):
    end.measure(0)
    device.read(PATIENCE)
    device.write(1.0, 0)
    end.take(now=1.0)
    first = address_of(end)
    with contextlib.closing(opened(end)) as second:
        second.read(0.0)
        end.take(now=1.05)
        assert address_of(end) == first
        assert end.target.figures()["busy"] == 1
        greeted(end, second, now=1.2)
        assert address_of(end) != first
        assert end.target.output(1.2) == (WIRING.null, Status.WAITING)


# --- wrong parameters -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"host": "rig.example"}, ("host", "rig.example", "IP address")),
        ({"bind": "localhost"}, ("bind", "localhost")),
        ({"host": "192.0.2.1"}, ("bind", "127.0.0.1", "192.0.2.1")),
        ({"host": "::1"}, ("bind", "::1")),
        ({"key": "k" * 65}, ("key", "65", "64")),
    ],
)
def test_wrong_parameters(parameters, words):
    with pytest.raises(BadInput) as error:
        UDP.open(UDP.Parameters(**parameters), WIRING, PERIOD)
    for word in words:
        assert word in str(error.value)


def test_taken_port(end):
    with pytest.raises(BadInput, match="port"):
        UDP.open(UDP.Parameters(local_port=end.address[1]), WIRING, PERIOD)
