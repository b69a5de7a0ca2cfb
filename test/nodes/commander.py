"""A controller of the simplest kind, which answers each snapshot as the last line on stdin says.

``sine A F`` commands A sin(2 pi F t) [m, Hz] and a little towards the middle of the stroke, ``constant U`` commands U [m],
``mute`` nothing, ``skip N`` null in every Nth cycle only. The one argument is the control period [s]. It says ``up`` once it
is there.
"""

import math
import signal
import sys
import threading

import rclpy
from rclpy.signals import SignalHandlerOptions

from ehls_msgs.msg import LoaderState, ValveCommand
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter

STIFFNESS, MOST = 1e-3, 1e-4
"""By how much of the position the command leads back [m/m], and how far at most [m]."""


def main() -> None:
    period, wanted = float(sys.argv[1]), ["mute"]
    threading.Thread(target=lambda: [wanted.append(line.strip()) for line in sys.stdin], daemon=True).start()
    stopping = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stopping.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("commander", namespace="ehls")
    inbox, outbox = Inbox(node, LoaderState, "loader_state"), Outbox(node, ValveCommand, "valve_command", frame_id="commander")
    waiter = Waiter([inbox])
    print("up", flush=True)
    while not stopping.is_set():
        waiter.wait(0.05)
        while (state := inbox.take()) is not None:
            stamp, cycle = state[:2]
            match wanted[-1].split():
                case ["sine", amplitude, frequency]:
                    turn = (float(frequency) * period * cycle) % 1.0
                    back = max(-MOST, min(MOST, -STIFFNESS * state[2]))
                    outbox.send(stamp, cycle, float(amplitude) * math.sin(2.0 * math.pi * turn) + back)
                case ["skip", count]:
                    if cycle % int(count) == 0:
                        outbox.send(stamp, cycle, 0.0)
                case ["constant", value]:
                    outbox.send(stamp, cycle, float(value))
    for part in (waiter, inbox, outbox):
        part.destroy()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
