"""Simple controller that answers each snapshot according to the last line on stdin: `commander.py NAME PERIOD`, period in s.

While another drives, it stands by. ``sine A F`` commands A sin(2 pi F t) [m, Hz] plus a little towards mid-stroke, ``constant
U`` commands U [m], ``mute`` nothing, ``skip N`` null on every Nth snapshot only. The other lines act in addition to the last
of these: ``duplicate U`` sends U for the same cycle as well, ``early N U`` for a future cycle, ``late N U`` for a past one.
``slow S`` answers S seconds later, and ``intrude U`` sends U to the valve even if another drives. It prints ``up`` once it is
running.
"""

import math
import sys
import time

from told_node import told_node

from ehls_msgs.msg import Driver, LoaderState, ValveCommand
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, control_qos
from ehls_ros.recording.topics import DRIVER, STANDBY_COMMAND

STIFFNESS, MOST = 1e-3, 1e-4
"""Feedback of the position to the command [m/m], and its limit [m]."""

BASIC = ("sine", "constant", "mute", "skip")
"""Lines that define the command; the others add to it."""


def main() -> None:
    name, period = sys.argv[1], float(sys.argv[2])
    with told_node(name, LoaderState, "loader_state", "mute") as node:
        driver = Inbox(node.node, Driver, DRIVER.name, control_qos(10))
        standby = Outbox(node.node, ValveCommand, STANDBY_COMMAND.name, sender=name)
        waiter = Waiter([node.inbox])
        snapshots, basic, drives = 0, ["mute"], ""
        print("up", flush=True)
        while not node.stopping.is_set():
            waiter.wait(0.05)
            while (word := driver.take()) is not None:
                drives = word[3]
            while (state := node.inbox.take()) is not None:
                stamp, cycle = state[:2]
                snapshots += 1
                line = node.told().split()
                if line[0] in BASIC:
                    basic = line
                if line[0] == "slow":
                    time.sleep(float(line[1]))
                out = node.outbox if drives in {"", name} else standby
                command = basic_command(basic, period * cycle, state[2], snapshots)
                if command is not None:
                    out.send(stamp, cycle, command)
                match line:
                    case ["duplicate" | "intrude", value]:
                        node.outbox.send(stamp, cycle, float(value))
                    case ["early", cycles, value]:
                        node.outbox.send(stamp, cycle + int(cycles), float(value))
                    case ["late", cycles, value]:
                        node.outbox.send(stamp, max(cycle - int(cycles), 0), float(value))
        for part in (waiter, driver, standby):
            part.destroy()


def basic_command(line: list[str], time: float, position: float, snapshots: int) -> float | None:
    """Return the command [m] of a basic line at a time [s] and position [m]; None: no command for this snapshot."""
    match line:
        case ["sine", amplitude, frequency]:
            back = max(-MOST, min(MOST, -STIFFNESS * position))
            return float(amplitude) * math.sin(2.0 * math.pi * ((float(frequency) * time) % 1.0)) + back
        case ["skip", count]:
            return 0.0 if snapshots % int(count) == 0 else None
        case ["constant", value]:
            return float(value)
    return None


if __name__ == "__main__":
    main()
