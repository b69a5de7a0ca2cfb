"""A clock of this computer that can be compared with another device's for hours."""

import time

UNDISTURBED = 20e-6
"""Longest time to read the three clocks of :func:`free_running_time` without an interruption [s]."""


def free_running_time() -> float:
    """Return a monotonic time that includes suspension and that no time server adjusts [s].

    Linux adjusts the rate of ``CLOCK_MONOTONIC`` and ``CLOCK_BOOTTIME`` to a time server's, by up to 10 % with chrony.
    """
    for _ in range(3):
        before = time.clock_gettime(time.CLOCK_MONOTONIC)
        boot = time.clock_gettime(time.CLOCK_BOOTTIME)
        raw = time.clock_gettime(time.CLOCK_MONOTONIC_RAW)
        after = time.clock_gettime(time.CLOCK_MONOTONIC)
        if after - before < UNDISTURBED:
            break
    return raw + (boot - 0.5 * (before + after))
