"""The parts of the page, without a browser and without ROS."""

import asyncio
import contextlib

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="needs the extra `dashboard`")

from starlette.requests import HTTPConnection

from ehls_ros.dashboard import connections as module
from ehls_ros.dashboard.access import Access
from ehls_ros.dashboard.connections import PASSES, Connections, ConnectionState
from ehls_ros.dashboard.tuning import help_and_unit, place_of, reach, value_at
from ehls_ros.dashboard.window import INTERVAL, INTERVALS, OPEN, Window

PERIOD = 1e-3


def filled(window, first, cycles, *, peak_at=-1):
    cycle = np.arange(first, first + cycles)
    value = np.where(cycle == peak_at, 100.0, np.sin(cycle))
    window.add(cycle * PERIOD + PERIOD / 2, {"force": value, "stranger": value})
    return value


def test_an_interval_keeps_the_extreme_samples_in_whatever_portions_they_arrive():
    whole, parts = Window(["force"]), Window(["force"])
    value = filled(whole, 0, 1000, peak_at=333)
    for first in range(0, 1000, 7):
        filled(parts, first, min(7, 1000 - first), peak_at=333)
    seen = whole.part(0, -1)
    rows = value.reshape(-1, round(INTERVAL / PERIOD))[:-OPEN]
    np.testing.assert_array_equal(seen.low[:, 0], rows.min(axis=1))
    np.testing.assert_array_equal(seen.high[:, 0], rows.max(axis=1))
    np.testing.assert_array_equal(parts.part(0, -1).high, seen.high)
    assert seen.high.max() == 100.0


def test_parts_follow_without_a_gap_and_a_late_reader_gets_what_is_kept():
    window = Window(["force"])
    following, era, taken = 0, -1, []
    for first in range(0, 80_000, 250):
        filled(window, first, 250)
        part = window.part(following, era)
        assert part.first == following
        following, era = part.following, part.era
        taken.append(part.low)
    assert sum(map(len, taken)) == following == round(80_000 * PERIOD / INTERVAL) - OPEN
    late = window.part(0, era)
    assert late.following == following
    assert len(late.low) == INTERVALS - OPEN
    assert not np.isnan(late.low).any()


def test_missing_cycles_are_gaps_and_a_new_era_starts_from_nothing():
    window = Window(["force"])
    filled(window, 0, 200)
    filled(window, 400, 400)
    gap = np.isnan(window.part(0, -1).low[:, 0])
    assert gap[10:20].all()
    assert gap.sum() == 10
    before = window.part(0, -1).era
    window.restart()
    filled(window, 0, 300)
    part = window.part(20, before)
    assert part.era != before
    assert part.first == 0
    assert part.following == 15 - OPEN


@pytest.mark.parametrize(
    ("value", "minimum", "maximum", "ends"),
    [
        (12.0, 0.1, 1e3, (1.2, 120.0)),
        (12.0, 5.0, 20.0, (5.0, 20.0)),
        (-2.0, None, None, (-20.0, -0.2)),
        (0.0, 0.0, 50.0, (0.0, 50.0)),
        (0.0, None, None, (-1.0, 1.0)),
    ],
)
def test_a_slider_spans_a_decade_either_way_within_the_limits_of_the_node(value, minimum, maximum, ends):
    low, high = reach(value, minimum, maximum)
    assert (low, high) == pytest.approx(ends)
    assert value_at(place_of(value, low, high), low, high) == pytest.approx(value)
    assert (value_at(0.0, low, high), value_at(1.0, low, high)) == pytest.approx(ends)


def test_the_unit_of_a_description_is_shown_apart():
    assert help_and_unit("slope of the sliding surface [MPa/s]") == ("slope of the sliding surface", "MPa/s")
    assert help_and_unit("share of [a, b] [1]") == ("share of [a, b]", "")
    assert help_and_unit("gain [t/s]; default in proportion to the rig's mass") == (
        "gain; default in proportion to the rig's mass",
        "t/s",
    )
    assert help_and_unit("a sentence") == ("a sentence", "")


def connection(host="127.0.0.1:8765", path="/", query="", origin=None, client="127.0.0.1"):
    headers = [(b"host", host.encode())] + ([(b"origin", origin.encode())] if origin is not None else [])
    return HTTPConnection(
        {
            "type": "http",
            "path": path,
            "query_string": query.encode(),
            "headers": headers,
            "client": (client, 5),
            "scheme": "http",
        }
    )


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765"])
def test_the_loopback_interface_may_read_under_its_own_names(host):
    access = Access("127.0.0.1")
    assert access.refusal(connection(host, origin=f"http://{host}")) == ""
    assert not access.may_write(connection(host))
    assert access.may_write(connection(host, query=f"token={access.token}"))


@pytest.mark.parametrize(
    ("what", "word"),
    [
        ({"host": "rebound.example:8765"}, "Host"),
        ({"host": "192.0.2.1:8765"}, "Host"),
        ({"host": ""}, "Host"),
        ({"host": "["}, "Host"),
        ({"origin": "http://elsewhere.example"}, "Origin"),
        ({"origin": "http://127.0.0.1:9"}, "Origin"),
        ({"origin": "null"}, "Origin"),
        ({"query": "token=guessed"}, "token"),
        ({"query": "token="}, ""),
        ({"query": "token=ü"}, "token"),
    ],
)
def test_foreign_hosts_origins_and_tokens_are_refused(what, word):
    access = Access("127.0.0.1")
    assert word in access.refusal(connection(**what))
    assert not access.may_write(connection(**what))


def test_from_another_machine_even_reading_needs_the_token():
    access = Access("0.0.0.0")
    there = {"host": "192.0.2.1:8765", "client": "192.0.2.7"}
    assert "token is needed" in access.refusal(connection(**there))
    assert access.refusal(connection(**there, query=f"token={access.token}")) == ""
    assert access.refusal(connection(**there, path="/_nicegui/x.js")) == ""
    assert "Host" in access.refusal(connection("rebound.example:8765", client="192.0.2.7", query=f"token={access.token}"))


class Transport:
    """A connection that records whether it was cut."""

    def __init__(self, port):
        self.peer = ("192.0.2.7", port)
        self.closing = self.cut = False
        self.unsent = 0

    def get_extra_info(self, _):
        return self.peer

    def is_closing(self):
        return self.closing or self.cut

    def get_write_buffer_size(self):
        return self.unsent

    def abort(self):
        self.cut = True


@pytest.mark.parametrize(("state", "unsent"), [*((state, 0) for state in ConnectionState), (ConnectionState.ANSWERED, 100)])
def test_a_connection_has_as_many_passes_as_its_state_allows(state, unsent, monkeypatch):
    connections, transport, lived = Connections(), Transport(5), []
    transport.unsent = unsent

    async def count(_):
        # Replaces the wait between two passes.
        lived.append(transport.cut)
        if len(lived) > 200:
            raise asyncio.CancelledError

    monkeypatch.setattr(module.asyncio, "sleep", count)
    connections.opened(transport)
    transport.closing = state is ConnectionState.CLOSING
    if state is ConnectionState.OF_PAGE:
        connections.belongs(transport.peer, "page")
    answers = state is ConnectionState.ANSWERED and not unsent
    answered = connections.answered(transport.peer) if answers else contextlib.nullcontext()
    with answered, pytest.raises(asyncio.CancelledError):
        asyncio.run(connections.cut_slow())
    assert lived.count(False) == PASSES.get(state, 200) + 1


def test_idle_connections_are_cut_before_those_that_wait_for_an_answer():
    connections = Connections()
    busy, *idle = (Transport(port) for port in range(module.MAX_PER_PEER + 1))
    connections.opened(busy)
    with connections.answered(busy.peer):
        for transport in idle:
            connections.opened(transport)
        assert [transport.cut for transport in (busy, *idle)] == [False, True] + [False] * (module.MAX_PER_PEER - 1)
