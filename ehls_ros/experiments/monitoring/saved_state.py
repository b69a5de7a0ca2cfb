"""State of a monitor, from which another monitor of the same rig continues, and its records for files.

Records are plain values, with finite numbers and known names only.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.coefficients import kept
from ehls_ros.diagnosis.hypotheses import Candidate
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, PastReadings, Reading
from ehls_ros.diagnosis.result import Fitted
from ehls_ros.diagnosis.stages import STAGES
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.examination import FoundCause
from ehls_ros.experiments.monitoring.health import FoundChange
from ehls_ros.experiments.monitoring.identified import Identification
from ehls_ros.experiments.state_files.kinds import (
    CauseRecord,
    ChangeRecord,
    DirectionRecord,
    IdentificationRecord,
    MonitorState,
    ReadingRecord,
)
from ehls_ros.experiments.state_files.state_file import Origin
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.trajectory import Trajectory

MAX_CHANGES = 1000
"""Maximum number of changes kept, the newest."""

MAX_EFFECTS = 64
"""Maximum number of effects of a rig's model: each one slows down every later diagnosis."""


class LearntRig(NamedTuple):
    """The healthy rig as a monitor has learnt it.

    Attributes:
        kind: kind of baseline.
        directions: the departures tested.
        sections: scores of the healthy blocks, one section per condition of the rig.
        recording: the first minutes of the rig, if they are the baseline.
    """

    kind: str
    directions: tuple[Direction, ...]
    sections: tuple[tuple[Scores, ...], ...]
    recording: Trajectory | None = None


class SavedState(NamedTuple):
    """State of a monitor.

    Attributes:
        learnt: learnt model of the healthy rig; None while unknown.
        healthy_rig: model of the healthy rig.
        model: the same with the changes since.
        changes: detected changes, oldest first.
        history: the last readings of the coefficients.
        readings: the newest readings.
        watched: time for which blocks were judged [s].
        begins: begin times of the tested blocks [s].
        rows: score, information and share of these blocks, shape (3, blocks, n).
        identification: the identification of the healthy rig; None without one.
    """

    learnt: LearntRig | None
    healthy_rig: Rig
    model: Rig
    changes: tuple[FoundChange, ...]
    history: tuple[PastReadings, ...]
    readings: tuple[Reading, ...]
    watched: float
    begins: tuple[float, ...]
    rows: Array
    identification: Identification | None = None


def state_record(state: SavedState) -> dict[str, Any]:
    """Return a state, except for its arrays, as a record."""
    return {
        "well": rig_to_mapping(state.healthy_rig),
        "model": rig_to_mapping(state.model),
        "changes": [_change_record(change) for change in state.changes[-MAX_CHANGES:]],
        "history": [{"time": past.time, "readings": [*map(_finite_values, past.readings)]} for past in state.history],
        "readings": [*map(_finite_values, state.readings)],
        "watched": state.watched,
        "identification": None if state.identification is None else _identification_record(state.identification),
    }


def _identification_record(found: Identification) -> dict[str, Any]:
    return {
        "rig": rig_to_mapping(found.rig),
        "wrong": {path: wrong.given for path, wrong in found.wrong.items()},
        "estimates": {path: _finite_values(estimate) for path, estimate in found.estimates.items()},
        "why_not": dict(found.why_not),
    }


def state_of(
    record: MonitorState, origin: Origin, learnt: LearntRig | None, begins: tuple[float, ...], rows: Array
) -> SavedState:
    """Return a state.

    Args:
        record: the state except for its arrays.
        origin: the rig as described in its file.
        learnt: the healthy rig; None while unknown.
        begins: begin times of the tested blocks [s].
        rows: score, information and share of these blocks, shape (3, blocks, n).

    Raises:
        ValueError: the record is inconsistent.
    """
    return SavedState(
        learnt,
        rig_of(record.well, origin),
        rig_of(record.model, origin),
        tuple(map(change_of, record.changes)),
        tuple(PastReadings(past.time, readings_of(past.readings)) for past in record.history),
        readings_of(record.readings),
        record.watched,
        begins,
        rows,
        None if record.identification is None else identification_of(record.identification, origin),
    )


def identification_of(record: IdentificationRecord, origin: Origin) -> Identification:
    """Return an identification.

    Raises:
        ValueError: its rig is invalid, or it names an unknown coefficient.
    """
    rig = rig_of(record.rig, origin)
    try:
        for path in record.estimates:
            read(rig, path)
    except (LookupError, AttributeError, ValueError, BadInput):
        raise ValueError(f"the identification is of {path!r}") from None
    estimates = {path: Estimate(e.value, math.nan if e.std is None else e.std, e.unit) for path, e in record.estimates.items()}
    if unknown := record.wrong.keys() - estimates.keys():
        raise ValueError(f"a wrong number is {min(unknown)!r}, which is not identified")
    wrong = {path: Fitted(given, estimates[path], None) for path, given in record.wrong.items()}
    return Identification(rig, wrong, estimates, dict(record.why_not))


def rig_of(content: Mapping[str, Any], origin: Origin) -> Rig:
    """Return a rig's model: the rig's file with identified numbers and detected effects.

    Raises:
        ValueError: it differs from the file in other respects, or an effect is invalid.
    """
    constant = {*kept(rig_from_mapping(origin.rig, "rig")), "cylinder.model", "valve.model"}
    if _fixed(content, constant) != _fixed(origin.rig, constant):
        raise ValueError("the model belongs to another rig")
    effects = content.get("effects")
    if isinstance(effects, list) and len(effects) > MAX_EFFECTS:
        raise ValueError(f"the model of the rig has {len(effects)} effects, at most {MAX_EFFECTS}")
    return rig_from_mapping(content, "model of the rig")


def _fixed(content: Mapping[str, Any], constant: Collection[str]) -> dict[str, Any]:
    """Return what an identification keeps of a rig, in the sections of coefficients only the ``constant`` ones."""
    fitted_in = ("plant", "cylinder", "valve")
    fixed = {key: value for key, value in content.items() if key not in ("effects", "sensors", "friction", *fitted_in)}
    friction = content.get("friction")
    for section in fitted_in:
        values = content.get(section)
        if isinstance(values, Mapping):
            fixed[section] = {name: values.get(name) if f"{section}.{name}" in constant else None for name in values}
    if isinstance(friction, Mapping):
        fitted = {name for name, value in friction.items() if isinstance(value, float) or name == "element_stiffness"}
        fixed["friction"] = {name: None if name in fitted else value for name, value in friction.items()}
    return fixed


def _change_record(change: FoundChange) -> dict[str, Any]:
    causes = [{**c._asdict(), "parameters": {n: _finite_values(e) for n, e in c.parameters.items()}} for c in change.causes]
    return {**_finite_values(change), "causes": causes}


def change_of(record: ChangeRecord) -> FoundChange:
    """Return a change.

    Raises:
        ValueError: it names an unknown stage or cause.
    """
    if record.causes and record.stage not in STAGES:
        raise ValueError(f"a change is in the stage {record.stage!r}")
    causes = tuple(_cause(cause) for cause in record.causes)
    earliest = -math.inf if record.earliest is None else record.earliest
    # Unknown times are NaN.
    known: dict[str, Any] = {key: math.nan if value is None else value for key, value in record._asdict().items()}
    return FoundChange(**{**known, "causes": causes, "earliest": earliest})


def _cause(record: CauseRecord) -> FoundCause:
    known = EFFECTS.names()
    for name in (record.name, *record.equivalent_to):
        if name not in known:
            raise ValueError(f"a change has the cause {name!r}")
    parameters = {
        name: Estimate(value.value, math.nan if value.std is None else value.std, value.unit)
        for name, value in record.parameters.items()
    }
    return FoundCause(record.name, record.stage, record.probability, record.equivalent_to, parameters)


def readings_of(records: Sequence[ReadingRecord]) -> tuple[Reading, ...]:
    """Return readings.

    Raises:
        ValueError: a reading is of an unknown coefficient.
    """
    for record in records:
        if record.name not in COEFFICIENTS:
            raise ValueError(f"a reading is of the coefficient {record.name!r}")
        if record.deviation is not None and record.deviation <= 0.0:
            raise ValueError(f"a reading of {record.name} has the standard error {record.deviation:g}")
    return tuple(
        Reading(
            record.name,
            math.nan if record.value is None else record.value,
            math.inf if record.deviation is None else record.deviation,
            record.unit,
            record.why_not,
        )
        for record in records
    )


def direction_record(direction: Direction) -> dict[str, Any]:
    """Return a departure as a record."""
    cause = direction.cause
    arrays = {key: getattr(cause, key).tolist() for key in ("starts", "neutral")}
    bounds = {key: [_finite(bound) for bound in getattr(cause, key).tolist()] for key in ("lower", "upper")}
    values = {"parameter": direction.parameter, "values": direction.values.tolist()}
    return {**cause._asdict(), **arrays, **bounds, **values}


def direction_of(record: DirectionRecord) -> Direction:
    """Return a departure.

    Raises:
        ValueError: effect, parameters or lengths are inconsistent.
    """
    free = record.free
    if any(len(values) != len(free) for values in (record.lower, record.upper, record.units, record.neutral, record.values)):
        raise ValueError(f"a departure {record.name!r} has lists of several lengths")
    if record.name not in EFFECTS.names() or record.parameter not in free or not record.starts:
        raise ValueError(f"a departure is {record.name!r} in {record.parameter!r}")
    cause = Candidate(
        record.name,
        record.number,
        free,
        record.fixed,
        np.array(record.starts, dtype=np.float64).reshape(-1, len(free)),
        np.array([-np.inf if bound is None else bound for bound in record.lower]),
        np.array([np.inf if bound is None else bound for bound in record.upper]),
        record.units,
        np.array(record.neutral),
    )
    known = EFFECTS.load(record.name).Parameters._fields
    if any(name not in known for name in (*free, *dict(record.fixed))):
        raise ValueError(f"a departure {record.name!r} has unknown parameters")
    return Direction(cause, record.parameter, np.array(record.values))


def _finite(value: Any) -> Any:
    """Return a value; None for a number that is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _finite_values(record: FoundChange | Reading | Estimate) -> dict[str, Any]:
    """Return the fields of a tuple by name, None for numbers that are not finite."""
    return {key: _finite(value) for key, value in record._asdict().items()}
