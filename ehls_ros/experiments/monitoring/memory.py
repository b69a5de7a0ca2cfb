"""Persistent memory of a monitor in a folder, from which it resumes after a restart.

``memory.json`` is replaced atomically and names its files of arrays, so that a complete state exists whenever the process ends.
``coefficients.csv`` grows by one line for each identified coefficient. An unusable file is put aside unchanged, and only files
written by a monitor are replaced or removed.
"""

import math
import os
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import count, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.declared_arrays import Arrays, check_arrays
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.tracking import PastReadings
from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.errors import BadInput
from ehls_ros.experiments.monitoring.cycle_assembly import MAX_ANCHORS, Anchor
from ehls_ros.experiments.monitoring.saved_state import (
    LearntRig,
    SavedState,
    direction_of,
    direction_record,
    state_of,
    state_record,
)
from ehls_ros.experiments.state_files import table
from ehls_ros.experiments.state_files.access import NotWritten, check_writable
from ehls_ros.experiments.state_files.kinds import (
    BLOCK_ARRAYS,
    BLOCKS,
    HEALTHY,
    HEALTHY_ARRAYS,
    LEARNS_ANEW,
    MONITOR,
    MOST_BLOCKS,
    HealthyRig,
    MonitorState,
)
from ehls_ros.experiments.state_files.state_file import Kind, OfAnotherOrigin, Origin, StateFile
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

STATE = "memory.json"
"""Name of the state."""

COEFFICIENTS = "coefficients.csv"
"""Name of the coefficients' history."""

HEADING = ("time", "name", "value", "deviation", "unit")

ASIDE = "aside"
"""Prefix of the names of folders with unusable files."""

ARRAYS = re.compile(r"(learnt|blocks)_[0-9]{1,4}\.npz")
"""Names of the files of arrays."""

SAVE_INTERVAL = 60.0
"""Time between two saved states without events [s]."""

BLOCKS_SAVE_INTERVAL = 300.0
"""The same for the tested blocks, the largest part [s]; loss of the newest ones only delays the detection of a change."""

UNUSABLE = (ValueError, ArithmeticError, LookupError, TypeError)
"""Errors of a monitor caused by a memory that is inconsistent despite all checks."""


class SavedMonitor(NamedTuple):
    """Content of a folder.

    Attributes:
        state: the monitor's state.
        anchors: wall times along its time axis.
        end: newest time on it [s].
    """

    state: SavedState
    anchors: tuple[Anchor, ...]
    end: float


class Memory:
    """Memory of one monitor in a folder."""

    def __init__(self, folder: Path, origin: Origin, baselines: Sequence[str] = ()) -> None:
        """Use a folder; create it if missing.

        Args:
            folder: the folder.
            origin: the rig as described in its file, and the control period; the memory of another one is put aside.
            baselines: names of the recordings from which the monitor learns.

        Raises:
            BadInput: the folder cannot be created.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"the folder cannot be made ({error.strerror})", str(folder), "a writable folder") from None
        self._folder = folder
        self._origin = origin
        self._baselines = tuple(baselines)
        self._learnt: LearntRig | None = None
        self._learnt_file = self._blocks_file = ""
        self._model: Rig | None = None
        self._appended_until = -np.inf
        self._saved = self._saved_blocks = -np.inf
        self._history: table.Table | None = None

    def check_writable(self) -> None:
        """Check that the memory can be written.

        Raises:
            BadInput: it cannot be written.
        """
        check_writable(self._folder / STATE, "a writable folder", "the memory of the monitor")

    def close(self) -> None:
        """Close the coefficients' history."""
        if self._history is not None:
            self._history.close()
            self._history = None

    # --- reading --------------------------------------------------------------------------------------

    def restore(self) -> SavedMonitor | None:
        """Return the saved state of this rig; None if there is none.

        Raises:
            BadInput: the files are unusable, or belong to another rig, control period or baselines; see :meth:`put_aside`.
        """
        file = self._file(STATE, MONITOR)
        state = file.read()
        if state is None:
            return None
        content: MonitorState = state.content
        if content.baselines != self._baselines:
            raise file.refusal(f"it was learnt from the baselines {', '.join(content.baselines) or 'none'}")
        try:
            saved = self._saved_monitor(content)
        except BadInput:
            raise
        except UNUSABLE as error:
            raise file.refusal(str(error)) from None
        self._learnt, self._learnt_file = saved.state.learnt, content.learnt
        self._appended_until = saved.state.history[-1].time if saved.state.history else -np.inf
        return saved

    def put_aside(self, reason: BadInput) -> str:
        """Move unusable files unchanged into a separate folder.

        Args:
            reason: reason why they cannot be used.

        Returns:
            A sentence on the reason and the folder.
        """
        self._learnt, self._learnt_file, self._blocks_file = None, "", ""
        # The history does not identify its rig.
        history = (COEFFICIENTS,) if isinstance(reason, OfAnotherOrigin) else ()
        return self._move_aside(reason, STATE, *self._own_array_files(), *history)

    def _move_aside(self, reason: BadInput, *names: str) -> str:
        try:
            aside = next(path for n in count(1) if not os.path.lexists(path := self._folder / f"{ASIDE}-{n}"))
            aside.mkdir()
            for name in names:
                with suppress(FileNotFoundError):
                    (self._folder / name).rename(aside / name)
        except OSError as error:
            return f"{reason}; it cannot be put aside ({error.strerror})"
        return f"{reason}; it is now in {aside}"

    def _own_array_files(self) -> list[str]:
        """Return the names of a monitor's files of arrays in the folder; none if it cannot be listed."""
        named = list[str]()
        with suppress(OSError):
            named = [name for name in os.listdir(self._folder) if ARRAYS.fullmatch(name)]  # noqa: PTH208 - names alone
        return [name for name in named if self._file(name, _kind(name)).is_own()]

    def _file(self, name: str, kind: Kind) -> StateFile:
        return StateFile(self._folder / name, kind, self._origin)

    def _saved_monitor(self, content: MonitorState) -> SavedMonitor:
        anchors = tuple(Anchor(*anchor) for anchor in content.anchors)
        if len(anchors) > MAX_ANCHORS or any(later.time < earlier.time for earlier, later in pairwise(anchors)):
            raise ValueError("its anchors do not follow one another")
        if anchors and not anchors[-1].time <= content.end:
            raise ValueError("its anchors are later than its end")
        learnt = self._read_learnt(content.learnt) if content.learnt else None
        begins, rows = self._read_blocks(content.blocks, learnt) if content.blocks and learnt else ((), np.zeros((3, 0, 0)))
        saved = state_of(content, self._origin, learnt, begins, rows)
        return SavedMonitor(saved, anchors, content.end)

    def _arrays(self, name: str, kind: Kind) -> tuple[Any, Arrays]:
        """Return document and arrays of a file named in the state."""
        if not ARRAYS.fullmatch(name) or _kind(name) is not kind:
            raise ValueError(f"it names the file {name!r}")
        state = self._file(name, kind).read()
        if state is None:
            raise ValueError(f"the file {name} that it names is missing")
        return state.content, state.arrays

    def _read_learnt(self, name: str) -> LearntRig:
        about, arrays = self._arrays(name, HEALTHY)
        healthy: HealthyRig = about
        directions = tuple(direction_of(record) for record in healthy.directions)
        quantities = len(directions) + len(CHANNELS)
        check_arrays(arrays, HEALTHY_ARRAYS, {"quantities": quantities, "names": len(healthy.signals)})
        rows, lengths, instants = arrays["rows"], arrays["lengths"], arrays["time"]
        _check_rows(rows)
        if not len(lengths) or int(lengths.sum()) != rows.shape[1]:
            raise ValueError(f"{name} has other sections than blocks")
        blocks = [Scores(*row) for row in rows.swapaxes(0, 1)]
        ends = np.cumsum(lengths).tolist()
        sections = tuple(tuple(blocks[begin:end]) for begin, end in zip([0, *ends[:-1]], ends, strict=True))
        recording = None
        if len(instants):
            if np.any(np.diff(instants) <= 0.0):
                raise ValueError(f"{name} has times that do not increase")
            recording = Trajectory(instants, dict(zip(healthy.signals, arrays["signals"], strict=True)))
        return LearntRig(healthy.kind, directions, sections, recording)

    def _read_blocks(self, name: str, learnt: LearntRig) -> tuple[tuple[float, ...], Array]:
        _, arrays = self._arrays(name, BLOCKS)
        check_arrays(arrays, BLOCK_ARRAYS, {"quantities": len(learnt.directions) + len(CHANNELS)})
        begins, rows = arrays["begins"], arrays["rows"].astype(np.float64)
        _check_rows(rows)
        if len(begins) > MOST_BLOCKS or np.any(np.diff(begins) <= 0.0):
            raise ValueError(f"{name} has blocks that do not follow one another")
        return tuple(begins.tolist()), rows

    # --- writing --------------------------------------------------------------------------------------

    def due(self) -> bool:
        """Return whether to save the state although no event occurred."""
        return time.monotonic() - self._saved > SAVE_INTERVAL

    def save(self, state: SavedState, anchors: Sequence[Anchor], end: float, *, happened: bool = True) -> None:
        """Replace the saved state.

        Args:
            state: the monitor's current state.
            anchors: wall times along its time axis.
            end: newest time on it [s].
            happened: whether there was an event since; if not, the tested blocks are saved less often.

        Raises:
            NotWritten: a file cannot be written; the message has the file and the reason.
        """
        self._saved = now = time.monotonic()
        self._append(state.history, anchors)
        if state.learnt is None:
            self._learnt_file = self._blocks_file = ""
        else:
            if self._learnt is None or not self._learnt_file or not _is_unchanged(self._learnt, state.learnt):
                self._learnt_file = self._write(HEALTHY, *_learnt_content(state.learnt))
            if happened or self._model is not state.model or now - self._saved_blocks > BLOCKS_SAVE_INTERVAL:
                self._saved_blocks = now
                blocks = {"begins": np.array(state.begins), "rows": state.rows.astype(np.float32)}
                self._blocks_file = self._write(BLOCKS, {}, blocks)
        self._learnt, self._model = state.learnt, state.model
        content = {
            "baselines": list(self._baselines),
            "end": end,
            "anchors": list(anchors),
            **state_record(state),
            "learnt": self._learnt_file,
            "blocks": self._blocks_file,
        }
        self._file(STATE, MONITOR).write(content)
        for old in self._own_array_files():
            if old not in {self._learnt_file, self._blocks_file}:
                with suppress(OSError):
                    (self._folder / old).unlink()

    def _write(self, kind: Kind, content: Mapping[str, Any], arrays: Arrays) -> str:
        """Write arrays under an unused name, and return it."""
        used = {self._learnt_file, self._blocks_file}
        names = (f"{_prefix(kind)}_{i}.npz" for i in count())
        name = next(name for name in names if name not in used and self._is_free(name, kind))
        self._file(name, kind).write(content, arrays)
        return name

    def _is_free(self, name: str, kind: Kind) -> bool:
        return not os.path.lexists(self._folder / name) or self._file(name, kind).is_own()

    def _append(self, history: Sequence[PastReadings], anchors: Sequence[Anchor]) -> None:
        """Append new readings to the history."""
        new = [past for past in history if past.time > self._appended_until]
        if not new:
            return
        if self._history is None:
            self.open_history()
        if self._history is None:
            self._history = table.Table(self._folder / COEFFICIENTS, ",".join(HEADING), 0)
        for past in new:
            stamp = _wall_time(past.time, anchors)
            for reading in past.readings:
                if reading.identified:
                    cells = (stamp, reading.name, f"{reading.value:.8g}", f"{reading.deviation:.3g}", reading.unit)
                    self._history.add(",".join(cells))
        self._appended_until = new[-1].time
        self._history.flush()

    def open_history(self) -> str:
        """Open the coefficients' history; an unusable one is put aside.

        Returns:
            A sentence on that; empty if the history is continued.

        Raises:
            NotWritten: it cannot be opened for writing.
        """
        if self._history is not None:
            return ""
        path, heading, remark = self._folder / COEFFICIENTS, ",".join(HEADING), ""
        try:
            judged = table.judge(path, heading, check_cells, LEARNS_ANEW, "the coefficients' history")
        except BadInput as error:
            remark, judged = self._move_aside(error, COEFFICIENTS), table.Judged((), 0)
            if os.path.lexists(path):
                raise NotWritten(remark) from None
        if judged.end:
            self._history = table.Table(path, heading, judged.end)
        return remark


def check_cells(cells: Sequence[str]) -> None:
    """Check a line of the coefficients' history.

    Raises:
        ValueError: the line is invalid.
    """
    if len(cells) != len(HEADING):
        raise ValueError(f"a line has {len(cells)} values, not {len(HEADING)}")
    datetime.fromisoformat(cells[0])
    if not math.isfinite(float(cells[2])):
        raise ValueError(f"a line has the value {cells[2]}")
    float(cells[3])


def _kind(name: str) -> Kind:
    return HEALTHY if name.startswith("learnt") else BLOCKS


def _prefix(kind: Kind) -> str:
    return "learnt" if kind is HEALTHY else "blocks"


def _check_rows(rows: Array) -> None:
    """Reject negative information or share.

    Raises:
        ValueError: a value is negative.
    """
    if np.any(rows[1:] < 0.0):
        raise ValueError("a block has negative information")


def _wall_time(instant: float, anchors: Sequence[Anchor]) -> str:
    """Return the wall time of an instant, to the second, in UTC."""
    anchor = next((a for a in reversed(anchors) if a.time <= instant), anchors[0] if anchors else Anchor(instant, 0))
    return datetime.fromtimestamp(anchor.stamp_ns * 1e-9 + instant - anchor.time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _is_unchanged(one: LearntRig, other: LearntRig) -> bool:
    """Return whether nothing was learnt in between; a learnt section does not change."""
    return one.directions is other.directions and list(map(len, one.sections)) == list(map(len, other.sections))


def _learnt_content(learnt: LearntRig) -> tuple[dict[str, Any], Arrays]:
    blocks = [block for section in learnt.sections for block in section]
    recording = learnt.recording
    signals = {} if recording is None else recording.signals
    content = {
        "kind": learnt.kind,
        "directions": [direction_record(direction) for direction in learnt.directions],
        "signals": list(signals),
    }
    return content, {
        "rows": np.array([[getattr(block, field) for block in blocks] for field in ("score", "information", "share")]),
        "lengths": np.array([len(section) for section in learnt.sections], dtype=np.int64),
        "time": np.zeros(0) if recording is None else recording.time_s,
        "signals": np.array(list(signals.values())) if signals else np.zeros((0, 0)),
    }
