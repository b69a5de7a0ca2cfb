"""What a running programme leaves beside the run: the log of its load cycles, and the state from which it goes on."""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from ehls_ros.control.programme.counting import LoadCycle, Stiffness
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import Motion
from ehls_ros.errors import BadInput
from ehls_ros.schema import from_json

LOG = "load_cycles.csv"
"""Name of the log."""

STATE = "programme_state.json"
"""Name of the state."""

UNITS: Mapping[str, Mapping[str, str]] = {
    "force": {"value": "n", "stiffness": "n_m"},
    "position": {"value": "m", "stiffness": "1"},
}
"""Ends of the columns' names by what the programme is of."""


LONGEST_LINE = 4096
"""More bytes than a line of the log has."""


class Saved(NamedTuple):
    """Where a programme is.

    Attributes:
        programme: digest of what it consists of.
        period: of the control cycles [s].
        run: the rig's process that counts the control cycles.
        seen: newest control cycle known.
        published: last control cycle whose reference was published.
        counting: first control cycle of the load cycle under way.
        motions: what holds.
        stiffness: stiffness of the blocks that ran.
    """

    programme: str
    period: float
    run: str
    seen: int
    published: int
    counting: int
    motions: tuple[Motion, ...]
    stiffness: tuple[Stiffness, ...] = ()


def digest(programme: Programme) -> str:
    """Return a digest of what a programme's course depends on; its limits may change between two starts."""
    p = programme.parameters
    course = [_without_limits(p.blocks), p.start, p.transition]
    return hashlib.blake2b(json.dumps(course, sort_keys=True).encode(), digest_size=16).hexdigest()


def _without_limits(entries: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    kept = [{key: value for key, value in entry.items() if key != "limits"} for entry in entries]
    return [{**entry, "blocks": _without_limits(entry["blocks"])} if "blocks" in entry else entry for entry in kept]


def read_state(folder: Path) -> Saved | None:
    """Return the state in a folder; None if there is none.

    Raises:
        BadInput: the file cannot be read.
    """
    path = folder / STATE
    try:
        saved: Saved = from_json(Saved, path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise BadInput(
            f"the programme's state cannot be read ({error})", str(path), "the file as it was, or another folder"
        ) from None
    return saved


def write_state(folder: Path, saved: Saved) -> None:
    """Replace the state in a folder at once: whatever kills the writer, the old one is there or the new one."""
    path = folder / STATE
    beside = path.with_suffix(".new")
    beside.write_text(json.dumps(_plain(saved)), encoding="utf-8")
    beside.replace(path)


def _plain(saved: Saved) -> dict[str, Any]:
    motions = [
        {**motion._asdict(), **{key: [part._asdict() for part in getattr(motion, key)] for key in ("legs", "skipped")}}
        for motion in saved.motions
    ]
    return {**saved._asdict(), "motions": motions, "stiffness": [entry._asdict() for entry in saved.stiffness]}


class CycleLog:
    """The log of load cycles: a CSV, one line each, which survives that the program is killed.

    Attributes:
        done: load cycles in it.
    """

    def __init__(self, folder: Path, follows: str, *, anew: bool) -> None:
        """Open the log, and cut off a last line that was not written to its end.

        Args:
            folder: where it is.
            follows: ``force`` or ``position``, what the programme is of.
            anew: begin a new log.

        Raises:
            BadInput: it cannot be written, or is not such a log.
        """
        path = folder / LOG
        heading = _heading(follows)
        try:
            if anew or not path.exists():
                path.write_text(f"{heading}\n", encoding="utf-8")
            with path.open("rb") as file:
                first = file.readline()
                size = file.seek(0, os.SEEK_END)
                begin = file.seek(max(0, size - LONGEST_LINE))
                tail = file.read()
            if first.decode(errors="replace").strip() != heading:
                raise BadInput("the log has other columns", str(path), "another folder, or anew:=true")
            whole = tail.rfind(b"\n") + 1
            os.truncate(path, begin + whole)
            last = tail[:whole].splitlines()[-1]
            self.done = 0 if last == first.strip() else int(last.split(b",")[0])
            self._file: TextIO = path.open("a", encoding="utf-8")
        except OSError as error:
            raise BadInput(f"the log cannot be written ({error.strerror})", str(path), "a writable folder") from None

    def add(self, cycles: Iterable[LoadCycle], stamp_s: float) -> None:
        """Write load cycles that were finished at a time [s]; see :meth:`flush`."""
        for cycle in cycles:
            numbers = (f"{value:.9g}" if isinstance(value, float) else str(value) for value in cycle)
            self._file.write(f"{','.join(numbers)},{stamp_s:.6f}\n")
            self.done = cycle.load_cycle

    def flush(self) -> None:
        """Hand what was written to the system."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _heading(follows: str) -> str:
    unit = UNITS[follows]
    ends = dict.fromkeys(("peak", "valley", "mean", "reference_peak", "reference_valley", "error"), unit["value"])
    ends |= {"lowest_position": "m", "highest_position": "m", "stiffness": unit["stiffness"]}
    names = [f"{name}_{ends[name]}" if name in ends else name for name in LoadCycle._fields]
    return ",".join([*names, "time_s"])
