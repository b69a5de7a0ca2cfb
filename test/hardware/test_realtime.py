"""Restriction of a node to processors."""

import os
import threading

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.hardware.realtime import keep_to, processors_of


@pytest.mark.parametrize("text", ["no", "1-", "-1", "2-1", "4095", ","])
def test_a_list_that_names_no_processor_of_this_machine_is_refused(text):
    with pytest.raises(BadInput, match="processors is"):
        processors_of(text, "node")


def test_numbers_and_ranges_are_read():
    allowed = sorted(os.sched_getaffinity(0))
    assert processors_of("", "node") == frozenset()
    assert processors_of(f"{allowed[0]}", "node") == {allowed[0]}
    if allowed == list(range(allowed[0], allowed[-1] + 1)):
        assert processors_of(f"{allowed[0]}-{allowed[-1]},{allowed[0]}", "node") == set(allowed)


def test_all_threads_keep_to_them_and_so_do_those_that_start():
    before = os.sched_getaffinity(0)
    ended, running = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: (running.set(), ended.wait()))
    thread.start()
    running.wait()
    found: list[set[int]] = []
    try:
        keep_to([max(before)])
        late = threading.Thread(target=lambda: found.append(os.sched_getaffinity(0)))
        late.start()
        late.join()
        assert {max(before)} == os.sched_getaffinity(thread.native_id) == found[0]
    finally:
        keep_to(before)
        ended.set()
        thread.join()
