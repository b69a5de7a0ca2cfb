"""Records of a running programme: the log of its load cycles, and the state from which it resumes.

Both are checked before either is changed: a state of another rig or programme, or one impossible for this programme, is
rejected, as is a log that does not match the state.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.control.programme.counting import LoadCycle
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import Runner
from ehls_ros.control.programme.motion_check import check_motions
from ehls_ros.errors import BadInput
from ehls_ros.experiments.state_files import access, table
from ehls_ros.experiments.state_files.access import FolderLock
from ehls_ros.experiments.state_files.kinds import PROGRAMME, ProgrammeState
from ehls_ros.experiments.state_files.state_file import Origin, StateFile
from ehls_ros.physics.parameters import Limits
from ehls_ros.schema import notes

LOG = "load_cycles.csv"
"""Name of the log."""

STATE = "programme_state.json"
"""Name of the state."""

UNITS: Mapping[str, Mapping[str, str]] = {
    "force": {"value": "n", "stiffness": "n_m"},
    "position": {"value": "m", "stiffness": "1"},
}
"""Suffixes of the column names by the controlled quantity of the programme."""

REMEDY = "the log as it was, another folder, or anew:=true to begin the programme anew"

FOREIGN = "a log of load cycles, or another folder"

MAX_HOLDS = 100
"""Maximum number of hold values in a state; they accumulate when the programme's file is changed between starts."""

MAX_HOLD = 1e6
"""Range of a programme's values if the rig file has no limits [N or m]."""

SETTINGS = ("hold", "stop_time", "hold_time")
"""Settings of a programme that may change between two starts: each change is reported."""


class Records(NamedTuple):
    """Open records of a programme; no other process may change them until they are closed.

    Attributes:
        state: state from which the programme resumes; None: it begins.
        log: log, open for further load cycles.
        counted: number of load cycles that are not counted again.
        remarks: sentences for the operator.
        lock: lock of the folder.
    """

    state: ProgrammeState | None
    log: "CycleLog"
    counted: int
    remarks: tuple[str, ...]
    lock: FolderLock

    def close(self) -> None:
        """Close the log, and release the folder."""
        self.log.close()
        self.lock.release()


def digest(programme: Programme) -> str:
    """Return a digest of a programme's course; its limits and its pacing may change between two starts."""
    p = programme.parameters
    course = [_course(p.blocks), p.start, p.transition]
    return hashlib.blake2b(json.dumps(course, sort_keys=True).encode(), digest_size=16).hexdigest()


def _course(entries: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    kept = [{key: value for key, value in entry.items() if key not in {"limits", "pacing"}} for entry in entries]
    return [{**entry, "blocks": _course(entry["blocks"])} if "blocks" in entry else entry for entry in kept]


def state_file(folder: Path, origin: Origin | None = None) -> StateFile:
    """Return the state file of a folder.

    Args:
        folder: folder of the programme.
        origin: rig and control period; None: not checked.
    """
    return StateFile(folder / STATE, PROGRAMME, origin)


def read_state(folder: Path, origin: Origin | None = None) -> ProgrammeState | None:
    """Return the state in a folder; None if there is none. Arguments as of :func:`state_file`.

    Raises:
        BadInput: the file cannot be used.
    """
    read = state_file(folder, origin).read()
    return None if read is None else read.content


def plain(state: ProgrammeState) -> dict[str, Any]:
    """Return a state as JSON values."""
    motions = [
        {**motion._asdict(), **{key: [part._asdict() for part in getattr(motion, key)] for key in ("legs", "skipped")}}
        for motion in state.motions
    ]
    return {**state._asdict(), "motions": motions, "stiffness": [entry._asdict() for entry in state.stiffness]}


def open_records(folder: Path, programme: Programme, origin: Origin, follows: str, limits: Limits, *, anew: bool) -> Records:
    """Lock a folder, check its state and log, and open the log.

    Args:
        folder: folder of the programme; created if missing.
        programme: the programme.
        origin: rig and control period.
        follows: quantity that the programme prescribes, ``force`` or ``position``.
        limits: limits of the rig.
        anew: whether to restart the programme from its beginning.

    Raises:
        BadInput: the folder cannot be written, or another programme runs in it; the state or the log is unusable, or they do
            not match.
    """
    file, path = state_file(folder, origin), folder / LOG
    file.check_writable()
    with ExitStack() as undo:
        lock = FolderLock(folder, "programme")
        undo.callback(lock.release)
        state = None if anew else read_state(folder, origin)
        check = LineCheck(len(programme.leaves), programme.load_cycles)
        # The lines of a log that is put aside are not checked, but it must be a log.
        line_check = check if state else lambda _: None
        judged = table.judge(path, heading(follows), line_check, REMEDY if state else FOREIGN, "the log")
        counted, remarks = 0, [lock.remark] if lock.remark else []
        if state is not None:
            try:
                check_state(state, programme, origin.control_period, value_range(limits, follows))
            except ValueError as error:
                raise file.refusal(str(error)) from None
            counted = _counted(programme, state, origin.control_period, check.last, path)
            if check.last < state.counted:
                remarks.append(f"{path} lacks the load cycles {check.last + 1} to {state.counted}, which were counted")
            remarks += _changes(state, programme)
        try:
            end = judged.end
            if state is None:
                # The state first: a log without a state restarts at the next start, too.
                old = [kept for kept, there in ((file.path, os.path.lexists(file.path)), (path, judged.lines)) if there]
                remarks += [f"{kept} of the programme before is now {access.put_aside(kept).name}" for kept in old]
                end = 0 if path in old else end
            records = Records(state, CycleLog(path, follows, end), counted, tuple(remarks), lock)
        except access.NotWritten as error:
            raise BadInput(f"the records cannot be written ({error})", str(folder), "a writable folder") from None
        undo.pop_all()
        return records


def _counted(programme: Programme, state: ProgrammeState, period: float, logged: int, path: Path) -> int:
    """Return the number of load cycles that are not counted again.

    Args:
        programme: the programme.
        state: state from which it resumes.
        period: period of the control cycles [s].
        logged: last load cycle in the log.
        path: path of the log, for the error.

    Raises:
        BadInput: the log is ahead of the state.
    """
    reached = int(Runner(programme, period, state.motions).rows(max(state.published, 0), 1).points.load_cycles[0])
    if logged > reached:
        raise BadInput(f"the log has load cycle {logged}, the programme has reached {reached}", str(path), REMEDY)
    return max(logged, state.counted)


def _changes(state: ProgrammeState, programme: Programme) -> list[str]:
    """Return a sentence for each setting that has changed since the last start."""
    out = []
    for name in SETTINGS:
        was, becomes = getattr(state, name), getattr(programme.parameters, name)
        if was != becomes:
            unit = notes(type(programme.parameters))[name].unit
            old, new = ("not given" if value is None else f"{value:g}" for value in (was, becomes))
            out.append(f"{name} of the programme was {old} and is {new} from the next stop on [{unit}]")
    return out


def check_state(state: ProgrammeState, programme: Programme, period: float, values: tuple[float, float]) -> None:
    """Check that a state is possible for a programme.

    Args:
        state: the state.
        programme: the programme.
        period: period of the control cycles [s].
        values: range of the rig's force [N] or position [m].

    Raises:
        ValueError: the state is impossible.
    """
    if state.programme != digest(programme):
        raise ValueError("it is of another programme")
    if not state.counting - 1 <= state.seen <= max(state.published, 0):
        where = f"cycle {state.counting} is counted, {state.seen} seen and {state.published} published"
        raise ValueError(f"its control cycles do not follow one another: {where}")
    if len(state.holds) > MAX_HOLDS:
        raise ValueError(f"{len(state.holds)} values were held, at most {MAX_HOLDS} can have been")
    if state.counted > programme.load_cycles:
        raise ValueError(f"{state.counted} load cycles are counted, the programme has {programme.load_cycles}")
    check_motions(state.motions, programme, period, state.holds, *values)
    blocks = [entry.block for entry in state.stiffness]
    if len(set(blocks)) < len(blocks) or any(not 0 <= block < len(programme.leaves) for block in blocks):
        raise ValueError("it has the stiffness of blocks that the programme does not have")
    if any(not (entry.total > 0.0 and entry.cycles > 0) for entry in state.stiffness):
        raise ValueError("it has a stiffness that is not positive")


def value_range(limits: Limits, follows: str) -> tuple[float, float]:
    """Return the range of a rig's forces [N] or positions [m]; wide for a rig file without limits."""
    low, high = (-limits.force, limits.force) if follows == "force" else limits.position
    return (low, high) if low < high else (-MAX_HOLD, MAX_HOLD)


class LineCheck:
    """Check of a log's lines.

    Attributes:
        last: number of the last load cycle; 0: none.
    """

    def __init__(self, blocks: int, load_cycles: int) -> None:
        """Start before the first line.

        Args:
            blocks: number of the programme's blocks.
            load_cycles: number of its load cycles.
        """
        self._blocks, self._load_cycles = blocks, load_cycles
        self.last = 0

    def __call__(self, cells: list[str]) -> None:
        """Check one line.

        Raises:
            ValueError: it is not a valid line of the log.
        """
        if len(cells) != len(LoadCycle._fields) + 1:
            raise ValueError(f"a line has {len(cells)} values, not {len(LoadCycle._fields) + 1}")
        numbers = {name: int(cell) if kind is int else float(cell) for (name, kind), cell in zip(_TYPES, cells, strict=False)}
        float(cells[-1])
        number = int(numbers["load_cycle"])
        if not 0 < number <= self._load_cycles:
            raise ValueError(f"a line has load cycle {number}, the programme has {self._load_cycles}")
        if not 0 <= numbers["block"] < self._blocks:
            raise ValueError(f"a line has block {numbers['block']}, the programme has {self._blocks}")
        if number <= self.last:
            raise ValueError(f"load cycle {number} follows load cycle {self.last}")
        self.last = number


_TYPES = tuple(LoadCycle.__annotations__.items())


class CycleLog:
    """Log of load cycles, a CSV with one line per cycle; it survives a kill of the process."""

    def __init__(self, path: Path, follows: str, end: int) -> None:
        """Open a log that has been checked.

        Args:
            path: the file.
            follows: quantity that the programme prescribes, ``force`` or ``position``.
            end: size of the part that is kept [B]; 0: a new log.

        Raises:
            access.NotWritten: the log cannot be written.
        """
        self._table = table.Table(path, heading(follows), end)

    def add(self, cycles: Iterable[LoadCycle], stamp_s: float) -> None:
        """Buffer load cycles completed at a time [s] for the next :meth:`flush`."""
        for cycle in cycles:
            numbers = (f"{value:.9g}" if isinstance(value, float) else str(value) for value in cycle)
            self._table.add(f"{','.join(numbers)},{stamp_s:.6f}")

    def flush(self, *, durable: bool = False) -> None:
        """Pass the added lines to the operating system.

        Args:
            durable: whether to secure them against a power failure, too.

        Raises:
            access.NotWritten: lines could not be written; they are kept.
        """
        self._table.flush()
        if durable:
            self._table.sync()

    def close(self) -> None:
        """Close the file."""
        self._table.close()


def heading(follows: str) -> str:
    """Return the log's first line."""
    unit = UNITS[follows]
    ends = dict.fromkeys(("peak", "valley", "mean", "reference_peak", "reference_valley", "error"), unit["value"])
    ends |= {"lowest_position": "m", "highest_position": "m", "stiffness": unit["stiffness"]}
    names = [f"{name}_{ends[name]}" if name in ends else name for name in LoadCycle._fields]
    return ",".join([*names, "time_s"])
