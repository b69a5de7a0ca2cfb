"""What a monitor keeps in a folder, so that one that was killed and started again goes on where it was.

``memory.json`` is replaced at once, and names the files of arrays that go with it; whatever ends the process, one whole state
is there. ``coefficients.csv`` grows by one line for each coefficient that the data told, and is never rewritten.
"""

import csv
import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.hypotheses import Candidate
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.examination import FoundCause
from ehls_ros.experiments.monitoring.following import Anchor
from ehls_ros.experiments.monitoring.health import FoundChange
from ehls_ros.experiments.monitoring.remembered import Learnt, Past, Remembered
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.trajectory import Trajectory

VERSION = 1
"""Of the files' layout; another one is not read."""

STATE = "memory.json"
"""Name of the state."""

COEFFICIENTS = "coefficients.csv"
"""Name of the coefficients' history."""

HEADING = ("time", "name", "value", "deviation", "unit")

OFTEN = 60.0
"""Time between two states, if nothing happens [s]."""

SELDOM = 300.0
"""The same for the sums of the test, which are the largest part [s]; without the newest of them, a change is noticed later."""

EXPECTED = "the files as a monitor left them; without them it learns anew"


class Kept(NamedTuple):
    """What a folder holds.

    Attributes:
        remembered: what the monitor knew.
        anchors: wall time along its axis.
        end: newest time on it [s].
    """

    remembered: Remembered
    anchors: tuple[Anchor, ...]
    end: float


def digest(rig: Rig) -> str:
    """Return a digest of a rig's description."""
    return hashlib.blake2b(json.dumps(rig_to_mapping(rig), sort_keys=True).encode(), digest_size=16).hexdigest()


class Memory:
    """The folder of one monitor."""

    def __init__(self, folder: Path, rig: Rig, baselines: Sequence[str] = ()) -> None:
        """Use a folder, and make it if it is not there.

        Args:
            folder: the folder.
            rig: the rig as its file describes it; the memory of another one is put aside.
            baselines: names of the recordings from which the monitor learns.

        Raises:
            BadInput: the folder cannot be made.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"the folder cannot be made ({error.strerror})", str(folder), "a writable folder") from None
        self._folder = folder
        self._of = {"version": VERSION, "rig": digest(rig), "baselines": list(baselines)}
        self._learnt: Learnt | None = None
        self._learnt_file = self._blocks_file = ""
        self._model: Rig | None = None
        self._told = -np.inf
        self._saved = self._saved_blocks = -np.inf

    # --- reading --------------------------------------------------------------------------------------

    def restore(self) -> Kept | None:
        """Return what was kept of this rig; None if nothing was.

        Raises:
            BadInput: the files cannot be read; the next state takes their place.
        """
        path = self._folder / STATE
        if not path.exists():
            return None
        try:
            state = json.loads(path.read_text(encoding="utf-8"))
            if {key: state.get(key) for key in self._of} != self._of:
                path.replace(path.with_suffix(".other_rig"))
                return None
            kept = self._kept(state, path)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, BadInput) as error:
            raise BadInput(f"what the monitor knew cannot be read ({error})", str(path), EXPECTED) from None
        self._learnt, self._learnt_file = kept.remembered.learnt, state["learnt"]
        self._told = kept.remembered.history[-1].time if kept.remembered.history else -np.inf
        return kept

    def _kept(self, state: Mapping[str, Any], path: Path) -> Kept:
        learnt = self._read_learnt(state["learnt"]) if state["learnt"] else None
        begins, rows = self._read_blocks(state["blocks"], learnt) if state["blocks"] and learnt else ((), np.zeros((3, 0, 0)))
        remembered = Remembered(
            learnt,
            rig_from_mapping(state["model"], str(path)),
            tuple(_change(entry) for entry in state["changes"]),
            tuple(Past(entry["time"], _readings(entry["readings"])) for entry in state["history"]),
            _readings(state["readings"]),
            float(state["watched"]),
            begins,
            rows,
        )
        return Kept(remembered, tuple(Anchor(float(t), int(ns)) for t, ns in state["anchors"]), float(state["end"]))

    def _read_learnt(self, name: str) -> Learnt:
        with np.load(self._folder / name, allow_pickle=False) as data:
            directions = tuple(_direction(entry) for entry in json.loads(str(data["directions"])))
            rows = data["rows"]
            if rows.shape[2] != len(directions) + len(CHANNELS):
                raise ValueError(f"{name} is of other directions")
            none = np.zeros((0, 0))
            blocks = [Scores(row[0], row[1], row[2], none) for row in rows.swapaxes(0, 1)]
            ends = np.cumsum(data["lengths"]).tolist()
            sections = tuple(tuple(blocks[begin:end]) for begin, end in zip([0, *ends[:-1]], ends, strict=True))
            recording = None
            if len(data["time"]):
                signals = {str(signal): data["signals"][i] for i, signal in enumerate(data["names"])}
                recording = Trajectory(data["time"], signals)
            return Learnt(str(data["kind"]), directions, sections, recording)

    def _read_blocks(self, name: str, learnt: Learnt) -> tuple[tuple[float, ...], Array]:
        with np.load(self._folder / name, allow_pickle=False) as data:
            begins, rows = tuple(data["begins"].tolist()), data["rows"].astype(np.float64)
        if rows.shape != (3, len(begins), len(learnt.directions) + len(CHANNELS)):
            raise ValueError(f"{name} is of other directions")
        return begins, rows

    # --- writing --------------------------------------------------------------------------------------

    def due(self) -> bool:
        """Tell whether a state should be kept although nothing happened."""
        return time.monotonic() - self._saved > OFTEN

    def keep(self, remembered: Remembered, anchors: Sequence[Anchor], end: float, *, happened: bool = True) -> None:
        """Replace what is kept.

        Args:
            remembered: what the monitor knows.
            anchors: wall time along its axis.
            end: newest time on it [s].
            happened: whether something happened since; if not, the sums are kept seldom.

        Raises:
            OSError: the disk is full or fails.
        """
        self._saved = now = time.monotonic()
        self._append(remembered.history, anchors)
        if remembered.learnt is None:
            self._learnt_file = self._blocks_file = ""
        else:
            if self._learnt is None or not self._learnt_file or not _same(self._learnt, remembered.learnt):
                self._learnt_file = self._write("learnt", _learnt_arrays(remembered.learnt))
            if happened or self._model is not remembered.model or now - self._saved_blocks > SELDOM:
                self._saved_blocks = now
                blocks = {"begins": np.array(remembered.begins), "rows": remembered.rows.astype(np.float32)}
                self._blocks_file = self._write("blocks", blocks)
        self._learnt, self._model = remembered.learnt, remembered.model
        state = {
            **self._of,
            "end": end,
            "anchors": list(anchors),
            "model": rig_to_mapping(remembered.model),
            "changes": [_plain_change(change) for change in remembered.changes],
            "history": [{"time": past.time, "readings": _plain_readings(past.readings)} for past in remembered.history],
            "readings": _plain_readings(remembered.readings),
            "watched": remembered.watched,
            "learnt": self._learnt_file,
            "blocks": self._blocks_file,
        }
        self._replace(self._folder / STATE, json.dumps(state).encode())
        for old in self._folder.glob("*.npz"):
            if old.name not in {self._learnt_file, self._blocks_file}:
                old.unlink(missing_ok=True)

    def _write(self, what: str, arrays: Mapping[str, Any]) -> str:
        """Write arrays under a name that no state uses yet, and return it."""
        used = {self._learnt_file, self._blocks_file}
        name = next(name for name in (f"{what}_{i}.npz" for i in range(3)) if name not in used)
        with (self._folder / name).open("wb") as file:
            np.savez(file, **arrays)
            os.fsync(file.fileno())
        return name

    @staticmethod
    def _replace(path: Path, content: bytes) -> None:
        beside = path.with_suffix(".new")
        with beside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)

    def _append(self, history: Sequence[Past], anchors: Sequence[Anchor]) -> None:
        """Append readings that are not there yet to the history."""
        new = [past for past in history if past.time > self._told]
        if not new:
            return
        self._told = new[-1].time
        path = self._folder / COEFFICIENTS
        with path.open("a", newline="", encoding="utf-8") as file:
            lines = csv.writer(file)
            if not file.tell():
                lines.writerow(HEADING)
            for past in new:
                stamp = _wall(past.time, anchors)
                lines.writerows(
                    (stamp, r.name, f"{r.value:.8g}", f"{r.deviation:.3g}", r.unit) for r in past.readings if r.told
                )


def _wall(instant: float, anchors: Sequence[Anchor]) -> str:
    """Return the wall time of an instant, to the second, in UTC."""
    anchor = next((a for a in reversed(anchors) if a.time <= instant), anchors[0] if anchors else Anchor(instant, 0))
    return datetime.fromtimestamp(anchor.stamp_ns * 1e-9 + instant - anchor.time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _same(one: Learnt, other: Learnt) -> bool:
    """Tell whether nothing was learnt in between; a section that was learnt does not change."""
    return one.directions is other.directions and list(map(len, one.sections)) == list(map(len, other.sections))


def _learnt_arrays(learnt: Learnt) -> dict[str, Any]:
    blocks = [block for section in learnt.sections for block in section]
    recording = learnt.recording
    return {
        "kind": learnt.kind,
        "directions": json.dumps([_plain_direction(direction) for direction in learnt.directions]),
        "rows": np.array([[getattr(block, field) for block in blocks] for field in ("score", "information", "share")]),
        "lengths": np.array([len(section) for section in learnt.sections]),
        "time": np.zeros(0) if recording is None else recording.time_s,
        "names": np.array([] if recording is None else list(recording.signals), dtype=np.str_),
        "signals": np.zeros((0, 0)) if recording is None else np.array(list(recording.signals.values())),
    }


def _plain_direction(direction: Direction) -> dict[str, Any]:
    cause = {
        key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in direction.cause._asdict().items()
    }
    return {"cause": cause, "parameter": direction.parameter, "values": direction.values.tolist()}


def _direction(entry: Mapping[str, Any]) -> Direction:
    cause = entry["cause"]
    free = tuple(cause["free"])
    arrays = {key: np.array(cause[key], dtype=np.float64) for key in ("starts", "lower", "upper", "neutral")}
    made = Candidate(
        name=str(cause["name"]),
        number=int(cause["number"]),
        free=free,
        fixed=tuple((str(name), float(value)) for name, value in cause["fixed"]),
        units=tuple(cause["units"]),
        **{**arrays, "starts": arrays["starts"].reshape(-1, len(free))},
    )
    # Unknown names of effect or parameters show here.
    made.use(made.neutral)
    return Direction(made, str(entry["parameter"]), np.array(entry["values"], dtype=np.float64))


def _plain_readings(readings: Sequence[Reading]) -> list[dict[str, Any]]:
    return [reading._asdict() for reading in readings]


def _readings(entries: Sequence[Mapping[str, Any]]) -> tuple[Reading, ...]:
    return tuple(Reading(**entry) for entry in entries)


def _plain_change(change: FoundChange) -> dict[str, Any]:
    causes = [
        {**cause._asdict(), "parameters": {name: list(value) for name, value in cause.parameters.items()}}
        for cause in change.causes
    ]
    return {**change._asdict(), "causes": causes}


def _change(entry: Mapping[str, Any]) -> FoundChange:
    causes = tuple(
        FoundCause(
            **{
                **cause,
                "equivalent_to": tuple(cause["equivalent_to"]),
                "parameters": {name: Estimate(*value) for name, value in cause["parameters"].items()},
            }
        )
        for cause in entry["causes"]
    )
    return FoundChange(**{**entry, "causes": causes, "depends_on": tuple(entry["depends_on"])})
