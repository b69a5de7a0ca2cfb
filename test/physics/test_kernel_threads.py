"""Generated modules imported by several threads at once."""

from concurrent.futures import ThreadPoolExecutor

from ehls_ros.physics.composition import kernel_module

SLOW = """import time
time.sleep(0.2)
whole = True
"""


def test_no_thread_gets_a_module_that_another_is_still_importing():
    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(lambda source: kernel_module(source).whole, [SLOW, SLOW])) == [True, True]
