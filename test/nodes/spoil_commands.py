"""A node between controller and bridge that spoils commands as the last line on stdin says: `spoil_commands.py SEED`."""

import math
import random
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator

import rclpy
from rclpy.signals import SignalHandlerOptions

from ehls_msgs.msg import ValveCommand
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter

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
    wanted, chance = ["none"], random.Random(int(sys.argv[1]))
    threading.Thread(target=lambda: [wanted.append(line.strip()) for line in sys.stdin], daemon=True).start()
    stopping = [False]
    signal.signal(signal.SIGINT, lambda *_: stopping.__setitem__(0, True))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("spoil_commands", namespace="ehls")
    inbox = Inbox(node, ValveCommand, "valve_command_unspoilt")
    outbox = Outbox(node, ValveCommand, "valve_command", frame_id="spoil_commands")
    waiter = Waiter([inbox])

    def arriving(mode: str) -> Iterator[Command]:
        while not stopping[0] and wanted[-1] == mode:
            waiter.wait(0.02)
            while (command := inbox.take()) is not None:
                yield command

    while not stopping[0]:
        mode = wanted[-1]
        for command in MODES[mode](arriving(mode), chance):
            outbox.send(*command)
    for part in (waiter, inbox, outbox):
        part.destroy()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
