"""Effects that begin or grow while the rig runs: the monitor's verdicts and their delay."""

import math
import time
import traceback
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.diagnosis.cases import ONE_BODY, Hidden, effect_of, rig, rig_file, shown
from benchmarks.monitor.streams import Onset, in_chunks, part, recording_of
from benchmarks.monitor.watching import Timed, powers
from benchmarks.rows import Row
from ehls_ros.experiments.monitoring.examination import Finding, Task, examine
from ehls_ros.experiments.monitoring.monitor import Monitor, Parameters
from ehls_ros.trajectory import Trajectory
from truth_generator import LISTED, draw_effect
from truth_generator.effects import EFFECTS

ONSET, AFTER = 90.0, 90.0
"""Onset of an effect, and duration of the watch from then on [s]."""

OFFLINE = 60.0
"""Length of the recording that an offline diagnosis is given [s]."""

LENGTHS = (2.5, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 60.0)
"""Lengths of a recording with the effect, among which the shortest that suffices for an offline diagnosis is sought [s]."""

GROWING, PIECES = 600.0, 60
"""Time over which an effect grows [s], shortened from an hour, and number of steps."""


def draw(seed: int, number: int, pool: Mapping[str, Any] | None = None) -> tuple[str, str, int, Hidden]:
    """Draw a case: effect, experiment, seed of the recording, and sizes that show in a minute of the experiment."""
    rng = np.random.default_rng([seed, number, 21])
    if pool is None:
        name = effect_of(seed, number)
    else:
        turn, place = divmod(number, len(pool))
        name = sorted(pool)[int(np.random.default_rng([seed, turn, 22]).permutation(len(pool))[place])]
    case = shown(rng, seed, number, "singles", OFFLINE, lambda: {name: draw_effect(name, rng, rig_file())})
    return name, case.experiment, case.record_seed, case.hidden


def names_of(found: Finding) -> list[str]:
    """Return the first cause of a diagnosis and its equivalents; none if it names none."""
    return [found.causes[0].name, *found.causes[0].equivalent_to] if found.names_causes else []


def offline(recording: Trajectory) -> list[str]:
    """Return the first cause that an offline diagnosis names, and its equivalents."""
    return names_of(examine(Task(recording, rig())))


def shortest(recording: Trajectory, onset: float, effect: str, longest: float) -> float | None:
    """Return the shortest of the lengths from the onset on from which a diagnosis names the effect, by bisection [s]."""
    below, found = -1, len([length for length in LENGTHS if length <= longest]) - 1
    while found - below > 1:
        middle = (found + below) // 2
        if effect in offline(part(recording, onset, onset + LENGTHS[middle])):
            found = middle
        else:
            below = middle
    return LENGTHS[found]


def watch(recording: Trajectory, onset: float, monitor: Monitor, examiner: Timed) -> list[Row]:
    """Feed a recording to a monitor until it has named a cause after the onset, and return its alarms."""
    alarms = list[Row]()
    examined = 0
    for times, signals in in_chunks(recording):
        known = len(monitor.changes)
        for event in monitor.add(times, signals):
            if event.kind in ("learnt", "watching"):
                examined = len(examiner.done)
                continue
            alarm: Row = {"time": event.time, "kind": event.kind, "text": event.text}
            if event.kind == "named":
                new = monitor.changes[known]
                known += 1
                alarm["names"] = [new.causes[0].name, *new.causes[0].equivalent_to] if new.causes else []
                alarm["wall_s"] = sum(e.wall_s for e in examiner.done[examined:])
                examined = len(examiner.done)
            alarms.append(alarm)
        if any(alarm["kind"] == "named" and alarm["time"] > onset for alarm in alarms):
            break
    return alarms


def run(seed: int, number: int) -> Row:
    """Watch a rig in which an effect begins.

    Returns:
        The result, JSON-compatible.
    """
    row: Row = {"seed": seed, "number": number, "onset": ONSET}
    began = time.perf_counter()
    try:
        name, experiment, record_seed, hidden = draw(seed, number)
        recording = recording_of(Onset(experiment, record_seed, ONSET + AFTER, [(ONSET, hidden)]))
        row |= {"effect": name, "experiment": experiment, "hidden": hidden[name], "record_seed": record_seed}
        row["offline"] = offline(part(recording, ONSET, ONSET + OFFLINE))
        row["bound"] = shortest(recording, ONSET, name, OFFLINE) if name in row["offline"] else None
        examiner = Timed()
        row["alarms"] = watch(recording, ONSET, Monitor(rig(), Parameters(), examiner), examiner)
        row["powers"] = powers(recording, rig())
    except Exception:  # noqa: BLE001
        # An exception in one case is a result, and must not end a long run.
        row["error"] = traceback.format_exc(limit=-6)
    return row | {"wall_s": time.perf_counter() - began}


def growable() -> dict[str, str]:
    """Return the effects that can grow from zero, each with its growing size."""
    out = {}
    for name in LISTED:
        sizes = [size for size, neutral in EFFECTS[name].neutral.items() if neutral in (0.0, 1.0)]
        if sizes and name not in ONE_BODY and name not in FROM_NOTHING_JUMPS:
            out[name] = sizes[0]
    return out


FROM_NOTHING_JUMPS = {"valve_second_order", "end_stop", "valve_saturation", "temperature_dependent_friction", "held_dropouts"}
"""Effects whose sizes do not vanish continuously."""


def grown(name: str, sizes: Mapping[str, Any], share: float) -> Hidden:
    """Return an effect at a share of its size."""
    neutral = EFFECTS[name].neutral
    size = growable()[name]
    return {name: {**sizes, size: neutral[size] + share * (sizes[size] - neutral[size])}}


def run_growing(seed: int, number: int) -> Row:
    """Watch a rig in which an effect grows.

    Returns:
        The result, JSON-compatible.
    """
    row: Row = {"seed": seed, "number": number, "onset": ONSET}
    began = time.perf_counter()
    try:
        name, experiment, record_seed, hidden = draw(seed, number, growable())
        begins = ONSET + np.arange(PIECES) * GROWING / PIECES
        growth = [(float(begin), grown(name, hidden[name], (i + 1) / PIECES)) for i, begin in enumerate(begins)]
        recording = recording_of(Onset(experiment, record_seed, ONSET + GROWING + OFFLINE, growth))
        row |= {"effect": name, "experiment": experiment, "hidden": hidden[name], "record_seed": record_seed}
        row["offline"] = offline(part(recording, ONSET + GROWING, ONSET + GROWING + OFFLINE))
        examiner = Timed()
        row["alarms"] = watch(recording, ONSET, Monitor(rig(), Parameters(), examiner), examiner)
        first = next((alarm["time"] for alarm in row["alarms"] if alarm["kind"] == "named"), math.nan)
        row["share"] = float(np.clip((first - ONSET) / GROWING, 0.0, 1.0))
        row["bound"] = first_told(recording, name) if name in row["offline"] else None
    except Exception:  # noqa: BLE001
        # An exception in one case is a result, and must not end a long run.
        row["error"] = traceback.format_exc(limit=-6)
    return row | {"wall_s": time.perf_counter() - began}


def first_told(recording: Trajectory, name: str) -> float:
    """Return the time from the onset after which a diagnosis of the last minute names a growing effect, by bisection [s]."""
    below, found = 0.0, GROWING + OFFLINE
    while found - below > GROWING / 16:
        middle = 0.5 * (below + found)
        if name in offline(part(recording, ONSET + middle - OFFLINE, ONSET + middle)):
            found = middle
        else:
            below = middle
    return found
