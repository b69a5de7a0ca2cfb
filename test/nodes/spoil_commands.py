"""Node between controller and bridge that spoils commands according to the last line on stdin: `spoil_commands.py SEED`.

It prints each mode and the monotonic time from which it spoils all commands in that way.
"""

import math
import random
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator

from told_node import told_node

from ehls_msgs.msg import ValveCommand
from ehls_ros.nodes.transport import Waiter

Command = tuple[int, int, float]
LOST = 0.1
DELAY = 20


def lose(commands: Iterator[Command], chance: random.Random) -> Iterator[Command]:
    return (command for command in commands if chance.random() >= LOST)


def delay(commands: Iterator[Command], chance: random.Random) -> Iterator[Command]:
    waiting: deque[Command] = deque()
    for command in commands:
        waiting.append(command)
        if len(waiting) > DELAY:
            yield waiting.popleft()


def duplicate(commands: Iterator[Command], chance: random.Random) -> Iterator[Command]:
    for command in commands:
        yield from (command,) * 3


def reorder(commands: Iterator[Command], chance: random.Random) -> Iterator[Command]:
    for command in commands:
        following = next(commands, None)
        if following is not None:
            yield following
        yield command


def replaced(value: float) -> Callable[[Iterator[Command], random.Random], Iterator[Command]]:
    return lambda commands, chance: ((stamp, cycle, value) for stamp, cycle, _ in commands)


MODES = {
    "none": lambda commands, chance: commands,
    "lost": lose,
    "delayed": delay,
    "duplicated": duplicate,
    "reordered": reorder,
    "nan": replaced(math.nan),
    "inf": replaced(math.inf),
    "minus_inf": replaced(-math.inf),
    "1e30": replaced(1e30),
}


def main() -> None:
    chance = random.Random(int(sys.argv[1]))
    with told_node("spoil_commands", ValveCommand, "valve_command_unspoilt", "none") as node:
        waiter = Waiter([node.inbox])

        def arriving(mode: str) -> Iterator[Command]:
            while not node.stopping.is_set() and node.told() == mode:
                waiter.wait(0.02)
                while (command := node.inbox.take()) is not None:
                    yield command[:-1]

        while not node.stopping.is_set():
            mode = node.told()
            print(f"{time.monotonic():.6f} {mode}", flush=True)
            for command in MODES[mode](arriving(mode), chance):
                node.outbox.send(*command)
        waiter.destroy()


if __name__ == "__main__":
    main()
