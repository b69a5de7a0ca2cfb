"""Conversion of a trajectory to messages."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.cdr import encode, flatten
from ehls_ros.recording.topics import CYCLE_TOPICS, LOADER_FRAME, LOADER_STATE, RESPONSE, SENDER, VALVE_COMMAND, Topic
from ehls_ros.recording.typestore import typestore
from ehls_ros.trajectory import Trajectory

MAX_STAMP_NS = 2**31 * 10**9
"""End of the range of a ROS time stamp [ns]."""


class Stream(NamedTuple):
    """The messages of one topic.

    Attributes:
        topic: the topic.
        sent_ns: times of sending, shape (n,) [ns].
        messages: the n messages as CDR.
    """

    topic: Topic
    sent_ns: NDArray[np.int64]
    messages: list[bytes]


def streams_of(trajectory: Trajectory, where: str, first: int = 0) -> list[Stream]:
    """Make the messages of every cycle topic for which the trajectory has signals.

    Args:
        trajectory: header stamps are its times rounded to nanoseconds, cycles count its samples.
        where: destination of the messages, for errors.
        first: cycle of the first sample.

    Returns:
        The topics with at least one message; a message whose signals are all NaN is omitted.

    Raises:
        BadInput: messages cannot express the trajectory.
    """
    stamps_ns = _stamps_ns(trajectory.time_s, where)
    streams = [_stream(topic, trajectory, stamps_ns, where, first) for topic in CYCLE_TOPICS]
    return [stream for stream in streams if stream.messages]


def _stamps_ns(time_s: NDArray[np.float64], where: str) -> NDArray[np.int64]:
    exact = np.rint(time_s * 1e9)
    if not len(exact):
        raise BadInput("the trajectory has no samples", where, "one sample or more")
    if not (exact[0] >= 0 and exact[-1] < MAX_STAMP_NS and (np.diff(exact) > 0).all()):
        what = f"time_s goes from {time_s[0]} to {time_s[-1]}"
        raise BadInput(what, where, "times from 0 s that increase by at least 1 ns per sample")
    return exact.astype(np.int64)


def _stream(topic: Topic, trajectory: Trajectory, stamps_ns: NDArray[np.int64], where: str, first: int) -> Stream:
    known = {field: trajectory[signal] for field, signal in topic.signals.items() if signal in trajectory}
    rows = np.flatnonzero(_present(topic, list(known.values()), len(trajectory)))
    seconds, nanoseconds = np.divmod(stamps_ns[rows], 10**9)
    values: dict[str, NDArray[Any] | str] = {
        "header.stamp.sec": seconds,
        "header.stamp.nanosec": nanoseconds,
        "header.frame_id": LOADER_FRAME,
        "cycle": first + rows,
        SENDER: "",
    }
    fields = flatten(typestore().fielddefs, topic.type)
    for field in fields:
        if field.name in known:
            values[field.name] = known[field.name][rows]
            if field.kind == "bool":
                _check_flags(topic.signals[field.name], known[field.name][rows], rows, where)
        elif field.many:
            values[field.name] = np.zeros((len(rows), 0))
        elif field.name in topic.signals:
            values[field.name] = np.full(len(rows), 0.0 if field.kind == "bool" else np.nan)
    sent_ns = stamps_ns[rows]
    if topic is VALVE_COMMAND and RESPONSE in trajectory:
        sent_ns = sent_ns + _response_ns(trajectory[RESPONSE][rows], rows, where)
    return Stream(topic, sent_ns, encode(fields, values))


def _present(topic: Topic, signals: list[NDArray[np.float64]], samples: int) -> NDArray[np.bool_]:
    """Return which samples have a message of the topic: all for a snapshot, otherwise those with a known signal."""
    if topic is LOADER_STATE:
        return np.ones(samples, np.bool_)
    present = np.zeros(samples, np.bool_)
    for values in signals:
        known = ~np.isnan(values)
        present |= known if known.ndim == 1 else known.any(axis=1)
    return present


def _check_flags(signal: str, values: NDArray[np.float64], rows: NDArray[np.intp], where: str) -> None:
    wrong = np.argwhere(~np.isin(values, (0.0, 1.0)))
    if len(wrong):
        what = f"{signal} is {values[tuple(wrong[0])]} at sample {rows[wrong[0][0]]}"
        raise BadInput(what, where, "0 or 1 where other signals of its topic are known")


def _response_ns(response_s: NDArray[np.float64], rows: NDArray[np.intp], where: str) -> NDArray[np.int64]:
    wrong = np.flatnonzero(~((response_s >= 0) & (response_s < MAX_STAMP_NS / 1e9)))
    if len(wrong):
        what = f"{RESPONSE} is {response_s[wrong[0]]} at sample {rows[wrong[0]]}"
        raise BadInput(what, where, "0 s or more for every valve command")
    return np.rint(response_s * 1e9).astype(np.int64)
