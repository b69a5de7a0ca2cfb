"""Where the friction of a block is known although its beginning is not: after the piston has slid."""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.samples import Mask


def has_slid(position: Array, travel: float, period: float) -> Mask:
    """Tell at which samples the state of the friction model follows from the motion before.

    It does once the piston has slid out of presliding in one direction, and no more once it has rested: what holds a stuck
    piston depends on micrometres that no sensor resolves, and is wrong by the same force for as long as it is stuck.

    Args:
        position: of the piston, smoothed, shape (n,) [m].
        travel: presliding travel [m].
        period: sampling period [s].
    """
    if travel <= 0.0:
        return np.ones(len(position), dtype=np.bool_)
    stride = max(1, round(rules.MONITOR_LOOK / period))
    longest = rules.MONITOR_REST / (stride * period)
    known = list[bool]()
    slides, direction, rested = False, 1.0, 0
    turned = farthest = anchor = float(position[0])
    for x in position[::stride].tolist():
        if direction * (x - farthest) > 0.0:
            farthest = x
        elif abs(x - farthest) > rules.MONITOR_TURN * travel:
            turned, farthest, direction = farthest, x, -direction
        if abs(x - anchor) > rules.MONITOR_TURN * travel:
            anchor, rested = x, 0
        else:
            rested += 1
        if rested > longest:
            slides, turned, farthest = False, x, x
        elif abs(x - turned) >= rules.MONITOR_SLID * travel:
            slides = True
        known.append(slides)
    return np.repeat(np.array(known, dtype=np.bool_), stride)[: len(position)]
