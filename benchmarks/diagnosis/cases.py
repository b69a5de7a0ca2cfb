"""Hidden cases of the clean exam: the rig is the model, apart from the hidden effects.

A case depends only on the seed of the run and its number, not on the number of cases.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from functools import cache, partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import yaml

from benchmarks.common import MEASURED_RIG, ROOT
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import FINE, LISTED, OUTSIDE, Day, FormErrors, Measurement, Recording, draw_effect, measured, record
from truth_generator.visibility import against, background

KINDS = ("singles", "pairs", "nothing", "outside")
ORDER = "sopsnsosnspsosnspsop"
"""Kinds of twenty consecutive cases by their first letters: 45 % singles, 20 % pairs, 15 % nothing, 20 % outside the list."""

EXPERIMENTS = {"rich": 0.45, "random": 0.3, "steps": 0.1, "paper_sine": 0.1, "servo": 0.05}
"""Probability of each experiment."""

SHOWS = 1.3
"""Minimum visibility of an effect in the experiment drawn; below it, size and experiment are drawn again."""

MOST_DRAWS = 40
"""Maximum number of draws of size and experiment for one case."""

ONE_BODY = {"hinge_backlash", "flexible_mode"}
"""Effects that the truth generator cannot combine."""


Hidden = dict[str, dict[str, Any]]
"""Sizes of hidden effects by name."""


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
        data: kind of the data in the exam `raw`; empty if all signals are present.
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
def rig_file() -> dict[str, Any]:
    """Return the content of the rig file."""
    content: dict[str, Any] = yaml.safe_load(MEASURED_RIG.read_text(encoding="utf-8"))
    return content


@cache
def rig() -> Rig:
    """Return the rig that the diagnosis is given."""
    return rig_from_mapping(rig_file(), str(MEASURED_RIG))


@cache
def sources() -> str:
    """Return a fingerprint of the sources of the diagnosis."""
    digest = hashlib.sha256()
    for folder in ("diagnosis", "physics"):
        for path in sorted((ROOT / "ehls_ros" / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def kind_of(number: int) -> str:
    """Return the kind of a case."""
    return {kind[0]: kind for kind in KINDS}[ORDER[number % len(ORDER)]]


def names_of(seed: int, number: int) -> tuple[str, ...]:
    """Return the effects hidden in a case: all equally often, in an order given by the seed."""
    kind = kind_of(number)
    if kind == "nothing":
        return ()
    before = sum(kind_of(n) == kind for n in range(number))
    if kind == "pairs":
        fair = [pair for pair in combinations(sorted(LISTED), 2) if set(pair) != ONE_BODY]
        return fair[int(np.random.default_rng([seed, number, 7]).integers(len(fair)))]
    pool = sorted(LISTED if kind == "singles" else OUTSIDE)
    turn, place = divmod(before, len(pool))
    order = np.random.default_rng([seed, turn, KINDS.index(kind)]).permutation(len(pool))
    return (pool[int(order[place])],)


def make(seed: int, number: int, duration: float) -> Case:
    """Draw a case."""
    rng = np.random.default_rng([seed, number])
    names = names_of(seed, number)

    def draw() -> Hidden:
        return {name: draw_effect(name, rng, rig_file()) for name in names}

    return shown(rng, seed, number, kind_of(number), duration, draw)


def shown(rng: np.random.Generator, seed: int, number: int, kind: str, duration: float, draw: Callable[[], Hidden]) -> Case:
    """Draw experiment and hidden effects until all of them show.

    Args:
        rng: random number generator, which `draw` uses too.
        seed: seed of the run.
        number: number of the case.
        kind: its kind.
        duration: duration of the recording [s].
        draw: draws the hidden effects.
    """
    redrawn = 0
    while True:
        experiment = str(rng.choice(list(EXPERIMENTS), p=list(EXPERIMENTS.values())))
        record_seed = int(rng.integers(2**31))
        hidden = draw()
        if "coupling_stiffness" in hidden:
            experiment = "servo"
        seen: dict[str, dict[str, float]] = {}
        if hidden:
            without = background(rig_file(), experiment, seed=record_seed, duration=duration)
        for name, sizes in hidden.items():
            alone = record(rig_file(), {name: sizes}, experiment, seed=record_seed, duration=duration, noise=0.0)
            seen[name] = {stage: round(value, 3) for stage, value in against(without, rig_file(), alone).items()}
        if all(max(stages.values()) >= SHOWS for stages in seen.values()) or redrawn >= MOST_DRAWS:
            return Case(seed, number, kind, experiment, record_seed, duration, hidden, seen, redrawn)
        redrawn += 1


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
    same = partial(
        record, rig_file(), hidden, experiment, seed=seed, duration=case.duration, forms=case.forms, day=condition,
        disturbed=case.disturbed,
    )  # fmt: skip
    if case.measurement is None:
        return same()
    return measured(same(rate=FINE, noise=0.0), rig_file(), seed, case.measurement)
