"""Plausibility of messages without a checksum: they decode, and their sending times agree with their neighbours'."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.recording.cdr import CdrError, Field, decode, flatten
from ehls_ros.recording.topics import CYCLE_TOPICS, Topic
from ehls_ros.recording.typestore import typestore

NEIGHBOURS = 17
"""Width of the median filter of the times of sending [messages]."""

OUTLYING_NS = 10 * 10**9
"""Largest plausible deviation from the median [ns]."""


def well_formed(topic: Topic, messages: Sequence[bytes]) -> list[bool]:
    """Return for each message whether it decodes as the topic's type.

    Args:
        topic: topic under which they are stored.
        messages: messages as CDR.
    """
    decodes = _decodes_in_bulk if topic in CYCLE_TOPICS else _decodes_one_by_one
    return [True] * len(messages) if decodes(topic.type, messages) else [decodes(topic.type, [message]) for message in messages]


def timely(stamps_ns: Sequence[int]) -> NDArray[np.bool_]:
    """Return for each message whether its time agrees with its neighbours'; a lasting step of the clock is plausible.

    Args:
        stamps_ns: times of sending of n messages, in storage order [ns].

    Returns:
        Flags of shape (n,).
    """
    stamps = np.array(stamps_ns, np.float64)
    around: NDArray[np.float64] = scipy.ndimage.median_filter(stamps, NEIGHBOURS, mode="nearest")
    return np.less_equal(np.abs(stamps - around), OUTLYING_NS)


@cache
def _fields(message_type: str) -> list[Field]:
    return flatten(typestore().fielddefs, message_type)


def _decodes_in_bulk(message_type: str, messages: Sequence[bytes]) -> bool:
    try:
        decode(messages, _fields(message_type), ())
    except CdrError:
        return False
    return True


def _decodes_one_by_one(message_type: str, messages: Sequence[bytes]) -> bool:
    try:
        for message in messages:
            typestore().deserialize_cdr(message, message_type)
    except Exception:  # noqa: BLE001 - rosbags raises any exception on invalid bytes
        return False
    return True
