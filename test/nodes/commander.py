"""A simple controller that answers each snapshot as the last line on stdin says: `commander.py PERIOD`, in s.

``sine A F`` commands A sin(2 pi F t) [m, Hz] plus a little towards mid-stroke, ``constant U`` commands U [m], ``mute`` nothing,
``skip N`` null on every Nth snapshot only. It prints ``up`` once it is running.
"""

import math
import sys

from told_node import told_node

from ehls_msgs.msg import LoaderState
from ehls_ros.nodes.transport import Waiter

STIFFNESS, MOST = 1e-3, 1e-4
"""Feedback of the position to the command [m/m], and its limit [m]."""


def main() -> None:
    period = float(sys.argv[1])
    with told_node("commander", LoaderState, "loader_state", "mute") as node:
        waiter = Waiter([node.inbox])
        snapshots = 0
        print("up", flush=True)
        while not node.stopping.is_set():
            waiter.wait(0.05)
            while (state := node.inbox.take()) is not None:
                stamp, cycle = state[:2]
                snapshots += 1
                match node.told().split():
                    case ["sine", amplitude, frequency]:
                        turn = (float(frequency) * period * cycle) % 1.0
                        back = max(-MOST, min(MOST, -STIFFNESS * state[2]))
                        node.outbox.send(stamp, cycle, float(amplitude) * math.sin(2.0 * math.pi * turn) + back)
                    case ["skip", count]:
                        if snapshots % int(count) == 0:
                            node.outbox.send(stamp, cycle, 0.0)
                    case ["constant", value]:
                        node.outbox.send(stamp, cycle, float(value))
        waiter.destroy()


if __name__ == "__main__":
    main()
