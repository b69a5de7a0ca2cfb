"""Results of one day from a monitor's folder, for the daily report: changes and coefficients."""

import math
from collections import deque
from collections.abc import Sequence
from datetime import date, datetime, timedelta
from pathlib import Path

from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS as KNOWN
from ehls_ros.diagnosis.monitoring.tracking import PastReadings, Reading
from ehls_ros.errors import BadInput
from ehls_ros.experiments.monitoring.health import Health, State, agreed
from ehls_ros.experiments.monitoring.memory import COEFFICIENTS, HEADING, STATE, UNUSABLE, check_cells
from ehls_ros.experiments.monitoring.monitor import Parameters
from ehls_ros.experiments.monitoring.replay import MonitoringResult
from ehls_ros.experiments.monitoring.saved_state import change_of, identification_of, readings_of, rig_of
from ehls_ros.experiments.monitoring.trends import MAX_HISTORY, rates
from ehls_ros.experiments.state_files import table
from ehls_ros.experiments.state_files.kinds import MONITOR, MonitorState
from ehls_ros.experiments.state_files.state_file import StateFile

EXPECTED = "the folder of a monitor, as its parameter folder names it"


def is_monitor_folder(folder: Path) -> bool:
    """Return whether a folder contains the memory of a monitor."""
    return (folder / STATE).is_file()


def results_of_day(folder: Path, day: date) -> tuple[MonitoringResult, datetime]:
    """Return the results of a monitor for a day, with times from its midnight on, and that midnight.

    Args:
        folder: folder of the monitor.
        day: day in the local time zone.

    Raises:
        BadInput: the folder is not readable as that of a monitor.
    """
    midnight = datetime.combine(day, datetime.min.time()).astimezone()
    file = StateFile(folder / STATE, MONITOR, None)
    read = file.read()
    if read is None:
        raise BadInput(f"there is no {STATE}", str(folder), EXPECTED)
    state: MonitorState = read.content
    try:
        found = state.identification
        healthy = rig_of(state.well, read.origin)
        rig = healthy if found is None or not found.wrong else rig_of(found.rig, read.origin)
        errors = {} if found is None else identification_of(found, read.origin).errors()
        changes, readings = agreed(tuple(map(change_of, state.changes)), readings_of(state.readings), healthy, True, errors)
    except BadInput:
        raise
    except UNUSABLE as error:
        raise file.refusal(str(error)) from None
    changes = tuple(change.with_times(lambda instant: _since(midnight, instant, state.anchors)) for change in changes)
    history = _history(folder / COEFFICIENTS, midnight)
    end = (datetime.now().astimezone() - midnight).total_seconds()
    missing = tuple(reading.name for reading in readings if not reading.identified)
    health = Health(end, State.WATCHING, "", changes, readings, state.watched, "the healthy rig", 0.0, rates(history))
    return MonitoringResult(rig, Parameters(), health, history, (), missing=missing), midnight


def _since(midnight: datetime, instant: float, anchors: Sequence[tuple[float, int]]) -> float:
    """Convert an instant on the monitor's axis to seconds from a midnight on."""
    known = [anchor for anchor in anchors if anchor[0] <= instant] or list(anchors[:1])
    if not math.isfinite(instant) or not known:
        return instant
    begin, stamp_ns = known[-1]
    return stamp_ns * 1e-9 + instant - begin - midnight.timestamp()


def _history(path: Path, midnight: datetime) -> tuple[PastReadings, ...]:
    """Return the last readings in the file up to the end of the day, with times from its midnight on."""
    until = midnight + timedelta(days=1)
    times = deque[datetime](maxlen=MAX_HISTORY)
    rows = deque[list[Reading]](maxlen=MAX_HISTORY)
    for cells in table.rows(path, ",".join(HEADING), check_cells, EXPECTED, "the coefficients' history"):
        stamp, name, value, deviation, unit = cells
        time = datetime.fromisoformat(stamp)
        if time.tzinfo is None or time >= until or name not in KNOWN:
            continue
        if not times or times[-1] != time:
            times.append(time)
            rows.append([])
        rows[-1].append(Reading(name, float(value), float(deviation), unit))
    return tuple(PastReadings((time - midnight).total_seconds(), tuple(read)) for time, read in zip(times, rows, strict=True))
