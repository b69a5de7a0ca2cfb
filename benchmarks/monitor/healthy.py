"""Hours of a healthy rig: the monitor's false alarm rate, and its sums compared with theory."""

import time
import traceback

from benchmarks.monitor.streams import episode, stretches_of
from benchmarks.monitor.watching import Timed, bounds, feed, powers, test_of, told
from benchmarks.rows import Row
from ehls_ros.experiments.monitoring.monitor import Monitor, Parameters

SETTINGS = (100.0, 1000.0)
"""Mean times between false alarms [h]; monitors run at the first, and the largest sums show what others would have noticed."""


def run(seed: int, number: int, duration: float, form: float | None, with_powers: bool) -> Row:
    """Watch an episode.

    Args:
        seed: of the streams.
        number: of the episode.
        duration: of the episode [s].
        form: largest form error, as a fraction of the largest terms.
        with_powers: whether to keep the inputs of the simpler detectors.

    Returns:
        The result, JSON-compatible.
    """
    row: Row = {"seed": seed, "number": number, "duration": duration, "forms": form}
    began = time.process_time()
    try:
        drawn = episode(seed, number, duration, form)
        row |= {"kind": drawn.kind, "programmes": ["+".join(s.programmes) for s in drawn.stretches]}
        examiner = Timed()
        monitor = Monitor(drawn.rig, Parameters(mean_time_between_false_alarms=SETTINGS[0]), examiner)
        largest, events, power = list[float](), list[Row](), list[list[float]]()
        made = 0.0
        for recording in stretches_of(drawn):
            before = time.process_time()
            events += [told(event) for event in feed(monitor, recording, largest)]
            made += time.process_time() - before
            if with_powers:
                power += powers(recording, drawn.rig)
        test = test_of(monitor)
        row |= {
            "watched_h": monitor.health().watched / 3600.0,
            "baseline": monitor.health().baseline,
            "events": events,
            "examined": [list(e) for e in examiner.done],
            "largest": largest,
            "bounds": bounds(monitor, SETTINGS),
            "quantities": 0 if test is None else len(test.healthy.level),
            "powers": power,
            "monitor_s": made,
        }
    except Exception:  # noqa: BLE001
        # An exception in one episode is a result, and must not end a long run.
        row["error"] = traceback.format_exc(limit=-6)
    return row | {"processor_s": time.process_time() - began}
