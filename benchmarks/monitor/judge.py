"""Whether and how late the monitor named a hidden effect.

An effect counts if a diagnosis of a minute with it finds it first: the monitor's test and delay are judged, not the diagnosis.
"""

from typing import NamedTuple

from benchmarks.rows import Row


class Judged(NamedTuple):
    """The judgement on one case.

    Attributes:
        counts: whether an offline diagnosis of 60 s finds the effect first.
        right: whether the monitor's first name is right.
        early: alarms before the onset.
        noticed: time from the onset to the first alarm after it [s]; None without one.
        named: time from the onset to the first name after it [s]; None without one.
        bound: shortest of the lengths after the onset whose offline diagnosis finds it [s].
        beyond: delay of the name beyond that [s].
        beyond_with_wall: the same with the time that the diagnoses until then took [s].
        words: the verdict in words.
    """

    counts: bool
    right: bool
    early: int
    noticed: float | None
    named: float | None
    bound: float | None
    beyond: float | None
    beyond_with_wall: float | None
    words: str


def judge(row: Row) -> Judged:
    """Judge a case."""
    onset, alarms = row["onset"], row["alarms"]
    after = [alarm for alarm in alarms if alarm["time"] > onset]
    noticed = next((alarm["time"] - onset for alarm in after if alarm["kind"] == "noticed"), None)
    first = next((alarm for alarm in after if alarm["kind"] == "named"), None)
    named = None if first is None else first["time"] - onset
    right = first is not None and row["effect"] in first["names"]
    bound = row.get("bound")
    counts = row["effect"] in row["offline"]
    beyond = named - bound if named is not None and right and bound is not None else None
    wall = sum(alarm.get("wall_s", 0.0) for alarm in after if first is not None and alarm["time"] <= first["time"])
    if first is not None:
        words = "|".join(first["names"]) or "unknown"
    else:
        words = "not noticed" if noticed is None else "noticed, not named"
    early = sum(alarm["kind"] in ("noticed", "named") for alarm in alarms if alarm["time"] <= onset)
    return Judged(counts, right, early, noticed, named, bound, beyond, None if beyond is None else beyond + wall, words)
