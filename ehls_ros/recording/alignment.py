"""Alignment of the recorded messages of all topics by control cycle."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.message_times import NEVER, UNIX_TIME, moment
from ehls_ros.recording.time_axis import check_jumps
from ehls_ros.recording.topics import CYCLE_TOPICS, LOADER_STATE, RESPONSE, VALVE_COMMAND

CYCLE = "cycle"
SECONDS = "header.stamp.sec"
NANOSECONDS = "header.stamp.nanosec"
SENT = "sent_ns"

UNIX_TIME_NS = round(UNIX_TIME * 1e9)
"""Stamp from which times are wall-clock times; these are made relative, as the time since 1970 has a resolution of only 0.2 µs
as a float in seconds."""

MessageColumns = Mapping[str, NDArray[Any]]
"""The messages of one topic in order of arrival: their fields, and their times of sending as :data:`SENT` [ns]."""


def align(topics: Mapping[str, MessageColumns], where: str) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Align the signals of all topics with the cycles of ``loader_state``.

    Args:
        topics: the messages by the topic's name, with a non-empty ``loader_state``.
        where: the bag, for the error.

    Returns:
        The sample times, shape (n,) [s], and the signals, shape (n,) or (n, elements).

    Raises:
        BadInput: the snapshots are from several runs, or their clock was set or is another one.
    """
    loader = topics[LOADER_STATE.name]
    cycles, first = _first_of_each_cycle(loader)
    _check_duplicates(loader, first[np.searchsorted(cycles, loader[CYCLE])], where)
    stamps_ns = loader[SECONDS][first].astype(np.int64) * 10**9 + loader[NANOSECONDS][first]
    _check_stamps(cycles, stamps_ns, loader[SENT][first].astype(np.int64), where)
    time_s = (stamps_ns - (stamps_ns[0] if stamps_ns[0] >= UNIX_TIME_NS else 0)) / 1e9
    check_jumps(time_s, where, lambda row: f"cycle {cycles[row]}")

    signals: dict[str, NDArray[np.float64]] = {}
    for topic in CYCLE_TOPICS:
        if topic.name not in topics:
            continue
        columns = topics[topic.name]
        target, source = _matches(cycles, columns)
        for field, signal in topic.signals.items():
            if field in columns:
                signals[signal] = _scatter(columns[field][source], target, len(cycles))
        if topic is VALVE_COMMAND:
            response_ns = columns[SENT][source] - loader[SENT][first][target]
            # A node in the plant's process has answered before either is sent, and its command is sent first.
            positive = response_ns >= 0
            if positive.any() or not positive.size:
                signals[RESPONSE] = _scatter(np.where(positive, response_ns / 1e9, np.nan), target, len(cycles))
    return time_s, signals


def _first_of_each_cycle(columns: MessageColumns) -> tuple[NDArray[np.uint64], NDArray[np.intp]]:
    """Return the cycles in order and, for each, the index of the first message to arrive."""
    cycles, first = np.unique(columns[CYCLE], return_index=True)
    return cycles, first


def _check_duplicates(loader: MessageColumns, original: NDArray[np.intp], where: str) -> None:
    """Reject differing snapshots of one cycle, since they are from different runs."""
    repeated = np.flatnonzero(original != np.arange(len(original)))
    for field, values in loader.items():
        same = np.array_equal(values[repeated], values[original[repeated]], equal_nan=True)
        if field != SENT and not same:
            cycle = loader[CYCLE][repeated[0]]
            raise BadInput(f"cycle {cycle} has two snapshots that differ", where, "the snapshots of one run")


def _check_stamps(cycles: NDArray[np.uint64], stamps_ns: NDArray[np.int64], sent_ns: NDArray[np.int64], where: str) -> None:
    """Reject stamps that do not increase, or that jump although the snapshots were sent without a gap."""
    steps = np.diff(stamps_ns) / 1e9
    excess = steps - np.diff(sent_ns) / 1e9
    wrong = np.flatnonzero((steps <= 0.0) | ((steps > NEVER) & (excess > NEVER)))
    if len(wrong):
        k = int(wrong[0])
        first, second = (moment(stamps_ns[i] / 1e9) for i in (k, k + 1))
        change = "does not increase" if steps[k] <= 0.0 else "jumps"
        what = f"time {change} from cycle {cycles[k]} to cycle {cycles[k + 1]}: header.stamp is {first} and {second}"
        expected = (
            f"the snapshots of one run, whose clock was not set; or a map of columns with {LOADER_STATE.name} as received"
        )
        raise BadInput(what, where, expected)


def _matches(cycles: NDArray[np.uint64], columns: MessageColumns) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return pairs of sample and message with the same cycle."""
    own, first = _first_of_each_cycle(columns)
    target = np.searchsorted(cycles, own)
    known = target < len(cycles)
    known[known] = cycles[target[known]] == own[known]
    return target[known], first[known]


def _scatter(values: NDArray[Any], target: NDArray[np.intp], samples: int) -> NDArray[np.float64]:
    column = np.full((samples, *values.shape[1:]), np.nan)
    column[target] = values
    return column
