"""The dashboard's server against clients that flood it, forge messages, or have no token: no graph, no browser."""

import contextlib
import re
import select
import socket
import time
import urllib.request

import pytest

pytest.importorskip("nicegui", reason="needs the extra `dashboard`")
pytest.importorskip("websockets", reason="needs websockets to speak to the server")

import websockets.exceptions
from patience import PATIENCE
from served import answer, begin, event, hear, open_socket, own_address, page, served, until
from websockets.protocol import State

from ehls_ros.dashboard.access import MAX_MESSAGE, MAX_PAGES
from ehls_ros.dashboard.connections import MAX_HEAD, MAX_PER_PEER

HALF_OPEN = (b"", b"GET / HTTP/1.1\r\nHost: x\r\n")
MANY = 200
GROWTH = 60.0
"""Maximum memory of an attack [MB]; without limits those below take more."""

elsewhere = pytest.mark.skipif(own_address() is None, reason="needs an address that is not the loopback's")


@pytest.fixture(scope="module")
def shown(nothing_left_behind):
    """Return a server on the loopback interface."""
    with served() as server:
        yield server


@pytest.fixture(scope="module")
def everywhere(nothing_left_behind):
    """Return a server on all interfaces."""
    with served("0.0.0.0") as server:
        yield server


@pytest.fixture
def here(shown):
    return f"http://127.0.0.1:{shown.port}/"


@pytest.fixture
def there(everywhere):
    """Return the server's address for other machines."""
    return f"http://{own_address()}:{everywhere.port}/"


def has_ended(connection):
    """Return whether the server has closed a connection; data sent before are discarded."""
    while select.select([connection], [], [], 0.0)[0]:
        try:
            if not connection.recv(65536):
                return True
        except OSError:
            return True
    return False


@contextlib.contextmanager
def connections(host, port, begun):
    """Open many connections that send nothing, or the beginnings of requests in turn."""
    with contextlib.ExitStack() as stack:
        opened = []
        for number in range(MANY):
            one = stack.enter_context(socket.create_connection((host, port), timeout=PATIENCE))
            with contextlib.suppress(OSError):
                one.sendall(begun[number % len(begun)])
            opened.append(one)
        yield opened


@pytest.mark.long
@elsewhere
def test_half_open_requests_take_a_few_places_and_end_after_seconds_while_others_are_served(everywhere, there):
    before = everywhere.memory()
    with connections(own_address(), everywhere.port, HALF_OPEN) as opened:
        until(lambda: everywhere.held() <= MAX_PER_PEER, "one address holds more than its share of connections")
        assert answer(f"{there}?token={everywhere.token}")[0] == 200
        assert answer(f"http://127.0.0.1:{everywhere.port}/")[0] == 200
        until(lambda: all(map(has_ended, opened)), "half-open requests are never closed")
    assert everywhere.memory() - before < GROWTH


@pytest.mark.long
@elsewhere
def test_a_request_that_trickles_in_is_cut_too(everywhere):
    with socket.create_connection((own_address(), everywhere.port), timeout=PATIENCE) as one:
        one.sendall(b"GET / HTTP/1.1\r\n")

        def ended():
            with contextlib.suppress(OSError):
                one.sendall(b"a: b\r\n")
            time.sleep(0.2)
            return has_ended(one)

        until(ended, "a request may take any time")


@elsewhere
def test_a_socket_without_a_page_is_refused_before_it_is_opened(everywhere, there):
    for number in ("", "00000000-0000-0000-0000-000000000000"):
        for _ in range(MANY // 2):
            with pytest.raises(websockets.exceptions.InvalidStatus) as caught:
                open_socket(there, number)
            assert caught.value.response.status_code == 403
    until(lambda: everywhere.held() == 0, "refused sockets stay open")


@elsewhere
def test_from_another_machine_the_token_gives_a_working_page(everywhere, there):
    assert answer(there)[0] == 403
    got = page(there, everywhere.token)
    with open_socket(there, got.number) as opened:
        begin(opened).send(event("event", got.click("enable")))
        until(lambda: "enable" in everywhere.requests(), "the button does nothing")


@pytest.mark.long
def test_on_this_machine_sockets_without_a_page_last_for_seconds_and_an_open_page_stays(shown, here):
    got = page(here, shown.token)
    with open_socket(here, got.number) as opened, contextlib.ExitStack() as stack:
        begin(opened)
        flood = []
        for _ in range(MANY):
            with contextlib.suppress(OSError, websockets.exceptions.InvalidHandshake):  # closed before it was answered
                flood.append(stack.enter_context(open_socket(here, "")))
        until(lambda: shown.held() <= MAX_PER_PEER + 1, "one address holds more than its share of connections")
        until(lambda: shown.held() == 1, "sockets without a page are never closed")
        until(lambda: all(one.state is State.CLOSED for one in flood), "sockets without a page are never closed")
        opened.send(event("event", got.click("enable")))
        until(lambda: "enable" in shown.requests(), "the open page was cut off")


def test_a_page_has_two_sockets_at_most(shown, here):
    number = page(here).number
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(open_socket(here, number)) for _ in range(5)]
        until(lambda: sum(one.state is State.CLOSED for one in opened) == 3, "a page may have any number of sockets")
        assert opened[-1].state is State.OPEN


@pytest.mark.long
def test_the_number_of_reading_pages_is_limited_and_leaves_room_for_writers():
    with served() as server:
        here = f"http://127.0.0.1:{server.port}/"
        before = server.memory()
        codes = [answer(here)[0] for _ in range(MANY)]
        # A page that is not opened is dropped after a while, making room for another.
        assert codes[: MAX_PAGES + 1] == [200] * MAX_PAGES + [503]
        assert set(codes) == {200, 503}
        assert answer(f"{here}?token={server.token}")[0] == 200
        assert server.memory() - before < GROWTH


def heard(port, request, *more):
    """Send a request in parts until the server hangs up; return its answer."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as one:
        one.sendall(request)
        with contextlib.suppress(OSError):
            for part in more:
                one.sendall(part)
        answered = b""
        with contextlib.suppress(OSError):
            while part := one.recv(65536):
                answered += part
        return answered.partition(b"\r\n")[0]


@pytest.mark.parametrize("begun", [b"GET /", b"GET / HTTP/1.1\r\nHost: x\r\nX: "], ids=["line", "header"])
def test_a_request_without_end_is_cut_off(shown, begun):
    before = shown.memory()
    heard(shown.port, begun, *[b"a" * 1_000_000] * 100)
    assert shown.memory() - before < GROWTH


@elsewhere
def test_a_document_needs_the_token_too_and_runs_without_the_pages_rights(everywhere, there):
    address, token = f"{there}documents/report", f"?token={everywhere.token}"
    assert answer(address)[0] == 403
    with urllib.request.urlopen(address + token, timeout=PATIENCE) as came:
        assert came.status == 200
        [sandbox] = re.findall("sandbox[^;]*", came.headers["content-security-policy"])
    assert "allow-same-origin" not in sandbox
    for other in ("verify", "", "..%2f..%2fetc%2fpasswd"):
        assert answer(f"{there}documents/{other}{token}")[0] == 404


@pytest.mark.parametrize(
    ("request_line", "code"),
    [
        (b"POST / HTTP/1.1\r\nContent-Length: 3", b"405"),
        (b"GET / HTTP/1.1\r\nContent-Length: 4000000000", b"413"),
        (b"GET / HTTP/1.1\r\nTransfer-Encoding: chunked", b"413"),
        (b"GET /../../etc/passwd HTTP/1.1", b"404"),
        (b"GET /_nicegui_ws/socket.io/?EIO=4&transport=polling HTTP/1.1", b"404"),
    ],
)
def test_unusual_requests_are_refused_and_the_connection_is_closed(shown, request_line, code):
    head = request_line + b"\r\nHost: 127.0.0.1\r\n\r\n"
    assert code in heard(shown.port, head, *[b"10000\r\n" + b"a" * 65536 + b"\r\n"] * 100)


def head_of(size, upgrade=b""):
    """Return a request head of a given size."""
    begun = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + upgrade + b"X: "
    return begun + b"a" * (size - len(begun) - 4) + b"\r\n\r\n"


@pytest.mark.parametrize("upgrade", [b"", b"Upgrade: websocket\r\nConnection: upgrade\r\n"], ids=["page", "socket"])
@pytest.mark.parametrize("size", [MAX_HEAD + 1, 40_000, 200_000])
def test_a_head_beyond_the_limit_is_refused_however_it_arrives(shown, size, upgrade):
    head = head_of(size, upgrade)
    assert len(head) == size
    assert heard(shown.port, head).startswith(b"HTTP/1.1 431 ")
    assert heard(shown.port, *(head[at : at + 1000] for at in range(0, size, 1000))).startswith(b"HTTP/1.1 431 ")


def test_a_head_up_to_the_limit_is_answered_also_behind_another_request(shown):
    bare = b"GET /favicon.ico HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    last = head_of(MAX_HEAD, b"Connection: close\r\n")
    assert heard(shown.port, last) == b"HTTP/1.1 200 OK"
    with socket.create_connection(("127.0.0.1", shown.port), timeout=PATIENCE) as one:
        one.sendall(bare + head_of(MAX_HEAD + 1))
        answered = b""
        with contextlib.suppress(OSError):
            while part := one.recv(65536):
                answered += part
    assert answered.count(b"HTTP/1.1 ") == 2
    assert b"HTTP/1.1 431 " in answered


def test_neither_the_token_nor_request_texts_are_printed(here, shown):
    token = shown.token
    for path in ("nothing", "_nicegui/nothing", "_nicegui/auto/static/nothing", "\x1b[31m"):
        assert answer(f"{here}{path.replace(chr(27), '%1b')}?token={token}")[0] == 404
    assert answer(f"{here}?token={token}")[0] == 200
    assert answer(f"{here}?token={token}x")[0] == 403
    with pytest.raises(websockets.exceptions.InvalidStatus):
        open_socket(here, "", transport="\x1b[31m", token=token)
    page(here, token)
    heard(shown.port, f"\x1b[31m?token={token}\r\n\r\n".encode())
    assert shown.said() == ""


WRONG = [
    "42",
    "42[",
    '42["event"]',
    '42["event",1]',
    '42[["event"],{}]',
    "42{}",
    "49",
    "2probe",
    "4",
    "\x1b[31m",
    "40/other",
    "43[]",
    "5",
]
LIES = ["connect", "disconnect", "handshake", "event", "ack", "log", "javascript_response", "constructor"]


def test_a_read_only_page_changes_nothing_whatever_it_sends(shown, here):
    shown.lines.clear()
    writer = page(here, shown.token)
    reader = page(here)
    forged = writer.click("emergency stop")
    own = [sent for _, sent in reader.listeners()]
    printed = {"level": "error", "message": "\x1b[31mforged"}
    said = [
        event("event", forged),
        event("event", forged | {"client_id": reader.number}),
        *(event("event", sent | changed) for sent in own for changed in ({}, {"args": ["["]}, {"args": 5}, {"id": "x"})),
        *(event("log", printed | {"client_id": number}) for number in (reader.number, writer.number)),
        event("log", {"client_id": reader.number, "level": "nonsense", "message": 5}),
        event("ack", {"client_id": writer.number, "next_message_id": 10**9}),
        event("ack", {"client_id": reader.number, "next_message_id": "x"}),
        event("javascript_response", {"client_id": reader.number, "request_id": "x", "result": "x"}),
        *(
            event("handshake", {"client_id": writer.number, "tab_id": "t", "document_id": "d"} | more)
            for more in ({}, {"next_message_id": "x"})
        ),
        *(
            event(name, {"client_id": number, "QUERY_STRING": "client_id=x"})
            for name in LIES
            for number in (reader.number, "", 5)
        ),
        event("event", {"client_id": reader.number, "id": 1, "listener_id": "x", "args": ["[" * 30_000]}),
        *WRONG,
        b"\x00\x01",
        '451-["event",{"_placeholder":true,"num":0}]',
        "42" + "9" * 5000 + "[]",
        "x" * (MAX_MESSAGE + 1),
    ]
    with open_socket(here, writer.number) as writing:
        begin(writing)
        for message in said:
            # One socket for each: most messages close it.
            with open_socket(here, reader.number) as reading, contextlib.suppress(websockets.exceptions.ConnectionClosed):
                begin(reading).send(message)
                # The answer to this shows that the server has processed the earlier messages.
                again = {"client_id": reader.number, "tab_id": "other", "document_id": "other"}
                reading.send(event("handshake", again).replace("42", "427", 1))
                hear(reading, "437[false]")
        writing.send(event("event", writer.click("enable")))
        until(lambda: "enable" in shown.requests(), "the writing page is no longer heard")
    assert shown.requests() == ["enable"]
    assert shown.said() == ""


def test_a_socket_without_a_page_speaks_for_none(shown, here):
    shown.lines.clear()
    writer = page(here, shown.token)
    with open_socket(here, "", implicit_handshake="false") as opened:
        begin(opened).send(event("event", writer.click("emergency stop")))
        with pytest.raises(websockets.exceptions.ConnectionClosed):
            opened.recv(timeout=PATIENCE)
    assert shown.requests() == []


def test_a_reader_that_sends_without_end_costs_no_memory_and_leaves_others_heard(shown, here):
    writer, reader = page(here, shown.token), page(here)
    dropped = event("log", {"client_id": reader.number, "message": "x" * (MAX_MESSAGE - 1000)})
    with open_socket(here, writer.number) as writing, open_socket(here, reader.number) as reading:
        begin(writing)
        begin(reading)
        before = shown.memory()
        shown.lines.clear()
        for number in range(2000):
            reading.send(dropped)
            if number == 1000:
                writing.send(event("event", writer.click("emergency stop")))
        until(lambda: shown.requests() == ["emergency stop"], "the writing page is no longer heard")
        assert shown.memory() - before < GROWTH


def test_endless_attachments_of_a_message_are_not_kept(shown, here):
    reader = page(here)
    with open_socket(here, reader.number) as reading:
        begin(reading)
        before = shown.memory()
        # Announces a binary event with a million attachments, then sends some.
        with contextlib.suppress(websockets.exceptions.ConnectionClosed):
            reading.send('451000000-["event",{"_placeholder":true,"num":0}]')
            for _ in range(3000):
                reading.send(b"x" * 60_000)
        assert shown.memory() - before < GROWTH
