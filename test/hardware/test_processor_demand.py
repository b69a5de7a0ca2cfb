"""A loop that demands a processor continuously gives SCHED_FIFO back; one that sleeps keeps it."""

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from ehls_ros.hardware.processor_demand import PAUSE, WINDOW, ProcessorDemand, statistics_of

RESOLUTION = 0.02
"""The system updates a running thread's statistics at its clock ticks, of up to 10 ms [s]."""


class Thread:
    """Made-up statistics of a thread: running time and queueing time."""

    def __init__(self, file):
        self.file = file
        self.ran = self.waited = self.now = 0.0
        self.spend(0.0, 0.0, 0.0)

    def spend(self, ran: float, waited: float, slept: float) -> float:
        self.ran, self.waited = self.ran + ran, self.waited + waited
        self.now += ran + waited + slept
        self.file.write_text(f"{round(1e9 * self.ran)} {round(1e9 * self.waited)} 12\n")
        return self.now


@pytest.fixture
def thread(tmp_path):
    return Thread(tmp_path / "schedstat")


def changes(demand: ProcessorDemand, thread: Thread, seconds: float, turn: tuple[float, float, float]) -> list[float]:
    """Return the times at which the complaint changed, for turns of running, queueing and sleeping time."""
    start = thread.now
    found = []
    while thread.now - start < seconds:
        if demand.look(thread.spend(*turn)):
            found.append(thread.now - start)
    return found


# Alone on a processor; one of three such loops on two processors; one of five on one.
@pytest.mark.parametrize("turn", [(0.01, 0.0, 0.0), (0.006, 0.004, 0.0), (0.002, 0.008, 0.0), (0.0095, 0.0, 0.0005)])
def test_a_loop_that_never_rests_yields_within_two_windows(thread, turn):
    demand = ProcessorDemand(0.9, thread.file)
    [yielded] = changes(demand, thread, 1.0, turn)
    assert yielded < 2 * WINDOW
    assert "processor_share is 90 %" in demand.complaint
    assert demand.given_back == 1
    demand.close()


@pytest.mark.parametrize(
    ("share", "turn"),
    [(0.9, (0.0004, 0.0001, 0.0005)), (0.9, (0.0085, 0.0, 0.0015)), (0.9, (0.0005, 0.0095, 0.0)), (1.0, (0.01, 0.0, 0.0))],
)
def test_a_loop_that_rests_or_has_no_limit_keeps_its_priority(thread, share, turn):
    demand = ProcessorDemand(share, thread.file)
    assert changes(demand, thread, 5 * WINDOW, turn) == []
    assert demand.figures()["priority_given_back"] == 0
    demand.close()


def test_priority_is_requested_again_after_a_rest_and_given_back_if_nothing_has_changed(thread):
    demand = ProcessorDemand(0.9, thread.file)
    changes(demand, thread, 2 * WINDOW, (0.01, 0.0, 0.0))
    [resumed, yielded] = changes(demand, thread, PAUSE + 2 * WINDOW, (0.01, 0.0, 0.0))
    assert PAUSE - 2 * WINDOW < resumed <= PAUSE + WINDOW
    assert yielded - resumed < 2 * WINDOW
    assert demand.given_back == 2
    demand.close()


def test_the_systems_statistics_distinguish_a_busy_thread_from_a_sleeping_one():
    # The thread's sleeping and working times are known, however often others preempt it.
    def demand(turn):
        """Return the seconds that a thread demand, worked, and did not sleep, over turns that return their sleeping time."""
        demand = ProcessorDemand(1.0, statistics_of(threading.get_native_id()))
        began = now = time.monotonic()
        demand.look(began)
        used, slept, worked = time.thread_time(), 0.0, 0.0
        while not demand.demand:
            worked = time.thread_time() - used
            slept += turn()
            now = time.monotonic()
            demand.look(now)
        demand.close()
        return demand.demand * (now - began), worked, time.monotonic() - began - slept

    def nap():
        time.sleep(0.05)
        return 0.05

    with ThreadPoolExecutor(1) as other:
        sleeper = other.submit(demand, nap).result()
    busy = demand(lambda: 0.0)
    for demand, worked, awake in (sleeper, busy):
        assert worked - RESOLUTION <= demand <= awake + RESOLUTION
    assert busy[1] > RESOLUTION


def test_missing_statistics_are_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        ProcessorDemand(0.9, tmp_path / "nothing")
    assert statistics_of(os.getpid()).exists()
