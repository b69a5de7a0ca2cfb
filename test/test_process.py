"""A process is stopped by a signal, whatever the signal interrupts."""

import multiprocessing
import signal
import sys
from types import FrameType
from typing import Any

from patience import PATIENCE

from ehls_ros.process import Stopping


def wait_while_signals_come() -> None:
    """Wait for a signal that arrives at each line of the wait, and of the functions it calls."""
    stopping = Stopping()
    signal.signal(signal.SIGUSR1, lambda *_: stopping.set())

    def interrupt(frame: FrameType, event: str, argument: Any) -> Any:
        signal.raise_signal(signal.SIGUSR1)
        return interrupt

    waited = [stopping.wait(0.0)]
    sys.settrace(interrupt)
    waited.append(stopping.wait(PATIENCE))
    stopping.set()
    sys.settrace(None)
    sys.exit(0 if waited == [False, True] and stopping.is_set() else 1)


def test_a_signal_that_interrupts_the_wait_for_it_ends_the_wait():
    process = multiprocessing.get_context("spawn").Process(target=wait_while_signals_come)
    process.start()
    process.join(PATIENCE)
    process.kill()
    process.join()
    assert process.exitcode == 0
