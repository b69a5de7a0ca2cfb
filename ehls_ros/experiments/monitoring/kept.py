"""What a monitor's folder says of a day: its changes and its coefficients, for the report of that day."""

import csv
import json
import math
from collections.abc import Mapping, Sequence
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any

from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.errors import BadInput
from ehls_ros.experiments.monitoring.health import FoundChange, Health, State
from ehls_ros.experiments.monitoring.memory import COEFFICIENTS, STATE, change_of, readings_of
from ehls_ros.experiments.monitoring.parameters import Parameters
from ehls_ros.experiments.monitoring.rates import MOST_HISTORY, rates
from ehls_ros.experiments.monitoring.remembered import Past
from ehls_ros.experiments.monitoring.replay import Watched
from ehls_ros.physics.rig import rig_from_mapping

EXPECTED = "the folder of a monitor, as its parameter folder names it"


def is_kept(folder: Path) -> bool:
    """Return whether a folder is a monitor's."""
    return (folder / STATE).is_file()


def watched_until(folder: Path, day: date) -> tuple[Watched, datetime]:
    """Return what a monitor knew of a day, with times from its midnight on, and that midnight.

    Args:
        folder: of the monitor.
        day: in the local time zone.

    Raises:
        BadInput: the folder cannot be read as a monitor's.
    """
    midnight = datetime.combine(day, datetime.min.time()).astimezone()
    path = folder / STATE
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
        rig = rig_from_mapping(state["well"], str(path))
        changes = tuple(_since(midnight, change_of(entry), state["anchors"]) for entry in state["changes"])
        readings = readings_of(state["readings"])
        history = _history(folder / COEFFICIENTS, midnight)
        end = (datetime.now().astimezone() - midnight).total_seconds()
        watched = float(state["watched"])
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise BadInput(f"the monitor's folder cannot be read ({error})", str(folder), EXPECTED) from None
    told = {reading.name for reading in readings if reading.told}
    missing = tuple(reading.name for reading in readings if reading.name not in told)
    health = Health(end, State.WATCHING, "", changes, readings, watched, "the healthy rig", 0.0, rates(history))
    return Watched(rig, Parameters(), health, history, (), missing=missing), midnight


def _since(midnight: datetime, change: FoundChange, anchors: Sequence[Sequence[float]]) -> FoundChange:
    """Return a change with times from a midnight on [s], which were on the monitor's axis."""

    def moved(instant: float) -> float:
        known = [anchor for anchor in anchors if anchor[0] <= instant] or list(anchors[:1])
        if not math.isfinite(instant) or not known:
            return instant
        begin, stamp_ns = known[-1]
        return stamp_ns * 1e-9 + instant - begin - midnight.timestamp()

    return change._replace(
        since=moved(change.since),
        earliest=moved(change.earliest),
        latest=moved(change.latest),
        noticed=moved(change.noticed),
        named=moved(change.named),
        cleared=moved(change.cleared),
    )


def _history(path: Path, midnight: datetime) -> tuple[Past, ...]:
    """Return the readings up to the end of the day, times from its midnight on."""
    if not path.exists():
        return ()
    rows: dict[float, list[Reading]] = {}
    until = midnight + timedelta(days=1)
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            time = datetime.fromisoformat(row["time"])
            if time < until:
                rows.setdefault((time - midnight).total_seconds(), []).append(_reading(row))
    return tuple(Past(time, tuple(read)) for time, read in list(rows.items())[-MOST_HISTORY:])


def _reading(row: Mapping[str, Any]) -> Reading:
    return Reading(str(row["name"]), float(row["value"]), float(row["deviation"]), str(row["unit"]))
