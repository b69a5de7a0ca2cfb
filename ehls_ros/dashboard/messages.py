"""Filter of the messages that a browser may send over its page's socket.

The libraries behind the socket trust their input: an event for another page's button, a text for the terminal, an announced
attachment that never comes. So each message is checked before they see it. A read-only page may only acknowledge received
messages.
"""

from collections.abc import Callable
from enum import Enum, auto
from typing import Any

import orjson

LARGEST = 64 * 1024
"""Maximum message size [B]; the text of a field is sent in one piece."""

_SIGNALS = {"1", "3", "40", "40{}", "41"}
"""Engine.IO and Socket.IO packets: close, pong, connect, connect, disconnect."""

_EVENT = "42"


class Verdict(Enum):
    """Treatment of a message."""

    PASSED = auto()
    DROPPED = auto()
    CUT_OFF = auto()
    """A browser running the page never sends this, so the socket is closed."""


def judge(text: str | None, page: str, *, writes: bool) -> Verdict:
    """Return the treatment of a message.

    Args:
        text: the message; None: it is binary.
        page: id of the page the socket belongs to; empty: none.
        writes: whether that page may change things.
    """
    if text in _SIGNALS:
        return Verdict.PASSED
    if text is None or not page or not text.startswith(_EVENT):
        return Verdict.CUT_OFF
    # A number before the bracket requests an acknowledgement.
    number, bracket, rest = text.removeprefix(_EVENT).partition("[")
    try:
        name, message = orjson.loads(bracket + rest)
        fits = message["client_id"] == page and (not number or (number.isdecimal() and len(number) < 10))
        known = fits and name in _CHECKS and _CHECKS[name](message)
    except (ValueError, TypeError, KeyError):
        return Verdict.CUT_OFF
    if not known:
        return Verdict.CUT_OFF
    return Verdict.PASSED if name in {"ack", "handshake"} or (name == "event" and writes) else Verdict.DROPPED


def _is_event(message: dict[str, Any]) -> bool:
    arguments = message.get("args", [])
    for argument in arguments:
        if argument is not None:
            orjson.loads(argument)
    return type(message["id"]) is int and type(message["listener_id"]) is str and type(arguments) is list


def _is_ack(message: dict[str, Any]) -> bool:
    return type(message["next_message_id"]) is int


def _is_handshake(message: dict[str, Any]) -> bool:
    names = all(type(message[name]) is str for name in ("tab_id", "document_id"))
    return names and type(message.get("old_tab_id")) in {str, type(None)} and type(message.get("next_message_id", 0)) is int


_CHECKS: dict[str, Callable[[dict[str, Any]], bool]] = {
    "event": _is_event,
    "ack": _is_ack,
    "handshake": _is_handshake,
    # Texts for the terminal and results of scripts: nothing here uses them.
    "log": lambda _: True,
    "javascript_response": lambda _: True,
}
