"""Hidden cases of the clean exam: the rig is the model, apart from the hidden effects.

A case depends only on the seed of the run and its number, not on the number of cases.
"""

import hashlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, is_dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import yaml

from benchmarks.common import RIGS, ROOT
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import FINE, Day, FormErrors, Measurement, Recording, listed_of, measured, record
from truth_generator.cases import EXPERIMENTS, KINDS, MOST_DRAWS, ONE_BODY, SHOWS, Hidden, draw_case, draw_shown, kind_of

__all__ = [
    "EXPERIMENTS", "KINDS", "MOST_DRAWS", "ONE_BODY", "RIGS", "SHOWS", "Case", "Hidden", "effect_of", "healthy_of", "kind_of",
    "make", "name_of", "recording_of", "rig", "rig_file", "shown", "sources", "trajectory_of",
]  # fmt: skip


class Case(NamedTuple):
    """A case to be diagnosed.

    Attributes:
        seed: seed of the run.
        number: number of the case in the run.
        kind: one of :data:`KINDS`.
        experiment: name of the experiment.
        record_seed: seed of the recording.
        duration: duration of the recording [s].
        hidden: sizes by effect.
        visibility: visibility of each effect alone, by stage.
        redrawn: draws that were rejected because an effect would not have shown.
        exam: name of the exam.
        forms: how the rig differs from every model; None if it does not.
        measurement: how the channels are sampled; None for all at once, without jitter.
        disturbed: whether a disturbance acts.
        healthy: experiment and seed of each healthy recording.
        days: condition of the rig in the recording and in the healthy ones, in that order; empty if it is always the same.
        share: fraction of the removable error power due to the hidden effect; None if it is the only cause.
        data: kind of the data in the exams of raw data and of one pressure; empty if all signals are present.
        rig: name of the rig.
    """

    seed: int
    number: int
    kind: str
    experiment: str
    record_seed: int
    duration: float
    hidden: Hidden
    visibility: dict[str, dict[str, float]]
    redrawn: int
    exam: str = "clean"
    forms: FormErrors | None = None
    measurement: Measurement | None = None
    disturbed: bool = True
    healthy: tuple[tuple[str, int], ...] = ()
    days: tuple[Day, ...] = ()
    share: float | None = None
    data: str = ""
    rig: str = "paper"

    def told(self) -> dict[str, Any]:
        """Return the case in JSON-compatible form."""
        return {name: _plain(value) for name, value in self._asdict().items()}


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return dict(value) if isinstance(value, Mapping) else value


@cache
def rig_file(name: str = "paper") -> dict[str, Any]:
    """Return the content of a rig file."""
    content: dict[str, Any] = yaml.safe_load(RIGS[name].read_text(encoding="utf-8"))
    return content


@cache
def rig(name: str = "paper") -> Rig:
    """Return the rig that the diagnosis is given."""
    return rig_from_mapping(rig_file(name), str(RIGS[name]))


@cache
def sources() -> str:
    """Return a fingerprint of the sources of the diagnosis."""
    digest = hashlib.sha256()
    for folder in ("diagnosis", "physics"):
        for path in sorted((ROOT / "ehls_ros" / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def name_of(exam: str, rig: str) -> str:
    """Return the name of an exam on a rig."""
    return exam if rig == "paper" else f"{rig} {exam}"


def make(seed: int, number: int, duration: float, rig: str = "paper") -> Case:
    """Draw a case."""
    drawn = draw_case(rig_file(rig), seed, number, duration)
    exam = name_of("clean", rig)
    return Case(seed, number, kind_of(number), drawn.experiment, drawn.record_seed, duration, *drawn[2:], exam, rig=rig)


def effect_of(seed: int, turn: int, rig: str = "paper", omitted: Collection[str] = ()) -> str:
    """Return the effect of the nth case that hides one: all equally often, in an order given by the seed."""
    pool = sorted(set(listed_of(rig_file(rig))) - set(omitted))
    again, place = divmod(turn, len(pool))
    return pool[int(np.random.default_rng([seed, again, 16]).permutation(len(pool))[place])]


def shown(
    rng: np.random.Generator,
    seed: int,
    number: int,
    kind: str,
    duration: float,
    draw: Callable[[], Hidden],
    rig: str = "paper",
) -> Case:
    """Draw experiment and hidden effects until all of them show.

    Args:
        rng: random number generator, which `draw` uses too.
        seed: seed of the run.
        number: number of the case.
        kind: its kind.
        duration: duration of the recording [s].
        draw: draws the hidden effects.
        rig: name of the rig.
    """
    drawn = draw_shown(rig_file(rig), rng, duration, draw)
    return Case(seed, number, kind, drawn.experiment, drawn.record_seed, duration, *drawn[2:], rig=rig)


def recording_of(case: Case) -> Recording:
    """Return a case's recording."""
    return _recorded(case, case.hidden, case.experiment, case.record_seed, 0)


def trajectory_of(recording: Recording) -> Trajectory:
    """Return a recording in the form that the diagnosis takes."""
    return Trajectory(recording.time, recording.columns)


def healthy_of(case: Case) -> list[Recording]:
    """Return the healthy recordings of the case's rig."""
    return [_recorded(case, {}, experiment, seed, 1 + i) for i, (experiment, seed) in enumerate(case.healthy)]


def _recorded(case: Case, hidden: Mapping[str, Any], experiment: str, seed: int, day: int) -> Recording:
    condition = case.days[day] if case.days else None
    content = rig_file(case.rig)
    same = partial(
        record, content, hidden, experiment, seed=seed, duration=case.duration, forms=case.forms, day=condition,
        disturbed=case.disturbed,
    )  # fmt: skip
    if case.measurement is None:
        return same()
    return measured(same(rate=FINE, noise=0.0), content, seed, case.measurement)
