"""Reconstruction of evenly spaced sending times of messages from scattered times of reception."""

import numpy as np
import scipy
from numpy.typing import NDArray

Times = NDArray[np.float64]

SMOOTHED = 2.0
"""Time over which the delay of messages is averaged [s]; the clock drift between sender and recorder is slower."""

AROUND = 20
"""Number of messages before and after one whose delays distinguish lost messages from late ones."""

LOST = 0.5
"""Change of the delay, in periods, above which messages were lost."""

EVEN = 0.5
"""Largest standard deviation of the delay, in periods, up to which messages were sent evenly."""


def sent_evenly(received: Times) -> Times | None:
    """Return the sending times of evenly sent messages, plus their mean delay.

    Args:
        received: times of reception, increasing, shape (n,) [s].

    Returns:
        Their times, shape (n,) [s]; None if they were not sent evenly.
    """
    if len(received) <= 4 * AROUND:
        return None
    # Over many messages the delays hardly matter, and losses are rare.
    period = float(np.median(received[2 * AROUND :] - received[: -2 * AROUND])) / (2 * AROUND)
    late = received - period * np.arange(len(received))
    # A late message does not delay others for long; a lost one shifts all later ones forward.
    usual = np.pad(scipy.ndimage.median_filter(late, AROUND), AROUND // 2, mode="edge")
    change = (usual[AROUND:] - usual[:-AROUND]) / period
    steps, lost = np.diff(received, prepend=received[0]), np.zeros(len(received))
    for place in scipy.signal.find_peaks(change, height=LOST, distance=AROUND)[0]:
        begin = max(0, place - AROUND // 2)
        lost[begin + np.argmax(steps[begin : place + AROUND // 2])] = np.round(change[place])
    number = np.arange(len(received)) + np.cumsum(lost)
    slope, start = np.polyfit(number, received - received[0], 1)
    even: Times = received[0] + start + slope * number
    window = max(1, round(SMOOTHED / period))
    even = even + scipy.ndimage.uniform_filter1d(received - even, min(window, len(received)), mode="nearest")
    return even if float(np.std(received - even)) <= EVEN * period and bool(np.all(np.diff(even) > 0.0)) else None
