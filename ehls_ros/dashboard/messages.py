"""What a page's browser may say over its socket.

The libraries behind the socket believe what they are told: an event for another page's button, a text for the terminal, a
promise of parts to come. So each message is looked at before they get it. A page that may not write has nothing to say but
how far it has heard.
"""

from collections.abc import Callable
from enum import Enum, auto
from typing import Any

import orjson

LARGEST = 64 * 1024
"""Size of the largest message [B]; what is typed into a field is sent whole."""

_SIGNALS = {"1", "3", "40", "40{}", "41"}
"""Of Engine.IO and Socket.IO: close, pong, connect, connect, disconnect."""

_EVENT = "42"


class Verdict(Enum):
    """What is done with a message."""

    PASSED = auto()
    DROPPED = auto()
    CUT_OFF = auto()
    """No browser that runs the page sends this: neither is the socket kept."""


def judge(text: str | None, page: str, *, writes: bool) -> Verdict:
    """Return what is done with a message.

    Args:
        text: the message; None: it is binary.
        page: number of the page the socket belongs to; empty: it belongs to none.
        writes: whether that page may change things.
    """
    if text in _SIGNALS:
        return Verdict.PASSED
    if text is None or not page or not text.startswith(_EVENT):
        return Verdict.CUT_OFF
    # A number before the bracket asks for an answer.
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
    # Nobody here waits for these two: texts for the terminal, results of scripts.
    "log": lambda _: True,
    "javascript_response": lambda _: True,
}
