"""The exams: the rig, its measured signals, and the inputs of the diagnosis.

clean: the rig is the model, apart from the hidden effects. partial: the rig has form errors in every stage, absent from all
models, and one hidden effect; the rig file is the nominal one. baseline: the same, with healthy recordings, and in half of the
cases without any change since. skew: the rig is the model, but every channel is skewed and jittered. forms: clean, but the
hidden effect, or one of a hidden pair, follows another formula of the same physics. raw: the rig is the model, but its data are
slow, at two rates, without the spool, of few signals, or of a single rod, in turn. neighbours: clean, two effects at once that
show most in the same or in adjacent stages. one_pressure: clean, on a single rod, of which one pressure is missing.

The exams clean, partial and baseline also exist for the single rod, under names of their own (`cases.name_of`).
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.diagnosis import cases, raw, single_rod
from benchmarks.diagnosis.cases import (
    EXPERIMENTS,
    MOST_DRAWS,
    ONE_BODY,
    SHOWS,
    Case,
    Hidden,
    effect_of,
    name_of,
    rig_file,
    shown,
)
from truth_generator import (
    LISTED,
    OTHER_FORMS,
    Day,
    FormErrors,
    draw_day,
    draw_effect,
    draw_forms,
    draw_measurement,
    draw_other_form,
    record,
)
from truth_generator.cases import experiments_of
from truth_generator.residuals import model_residuals
from truth_generator.visibility import Background, against, background, prominence, rows_between

Rng = np.random.Generator

STANDS_OUT = (2.0, 20.0)
"""Minimum and maximum of the target visibility of an effect on an imperfect rig, against noise and form errors."""

CANDIDATES = 6
"""Draws of an effect's size, of which the one nearest to the target visibility is taken."""

LEAST_FORM = 0.002
"""Minimum form error of a stage, as a fraction of its largest term."""

REMEMBERED = 0.3
"""Fraction of the form errors above which an effect must stand out if healthy recordings reveal them."""

JITTER = 0.1
"""Largest jitter of a rig with form errors, and that of the exam in skew, in samples."""

SPREAD = 0.02
"""Day-to-day spread of the friction level and of its viscous part."""

HEALTHY = {"rich": 0.6, "random": 0.4}
"""Probability of each experiment for a healthy recording."""

SKEW_EXPERIMENTS = ("rich", "random", "steps", "paper_sine")

DRAWS_OF_ONE = 8
"""Draws in which raw data may fail to show an effect before another effect is taken."""

CHAIN = ("valve", "flow", "force_balance", "sensors")
"""Stages in the order in which a command passes through them."""

LATE = ("command_delay", "sensor_delay")
LEAST_DELAY = 3e-3
"""Minimum hidden delay where up to a millisecond of it is skew [s]."""


class Exam(NamedTuple):
    """An exam.

    Attributes:
        kinds: kinds of its cases.
        kind_of: the kind of a case by its number.
        make: draws a case from the run's seed, its number and the duration of its recordings [s].
    """

    kinds: tuple[str, ...]
    kind_of: Callable[[int], str]
    make: Callable[[int, int, float], Case]


def _alternating(number: int) -> str:
    return ("singles", "nothing")[number % 2]


def _experiment(rng: Rng, name: str | None, among: dict[str, float] = EXPERIMENTS) -> str:
    drawn = str(rng.choice(list(among), p=list(among.values())))
    return "servo" if name == "coupling_stiffness" else drawn


def _seed(rng: Rng) -> int:
    return int(rng.integers(2**31))


# ----------------------------------------------------------------------------------------------- rigs that no model describes


class _Scene:
    """An experiment on an imperfect rig in a given condition, and the visibility of an effect in it."""

    def __init__(self, rig: str, forms: FormErrors, day: Day | None, weight: float, where: tuple[str, int, float]) -> None:
        self.rig, self.forms, self.day, self.weight = rig, forms, day, weight
        self.experiment, self.seed, self.duration = where
        self.model: Background = background(rig_file(rig), self.experiment, seed=self.seed, duration=self.duration)
        own = self._left({}, None)
        self.healthy = own if day is None else self._left({}, day)
        # Day-to-day variation counts fully: no healthy recording shows that of another day.
        self.rest = [(weight, rows_between(own, self.model.left)), (1.0, rows_between(self.healthy, own))]

    def _left(self, hidden: dict[str, Any], day: Day | None) -> dict[str, list[np.ndarray]]:
        rig = rig_file(self.rig)
        r = record(rig, hidden, self.experiment, seed=self.seed, duration=self.duration, noise=0.0, forms=self.forms, day=day)
        return model_residuals(rig, r)

    def prominence(self, hidden: dict[str, Any]) -> Any:
        return prominence(self.model, self.rest, self.healthy, self._left(hidden, self.day))

    def with_forms(self, forms: FormErrors) -> "_Scene":
        return _Scene(self.rig, forms, self.day, self.weight, (self.experiment, self.seed, self.duration))


def _sized(rng: Rng, name: str, scene: _Scene) -> tuple[_Scene, dict[str, Any], Any] | None:
    """Draw an effect that is visible above the rest; if impossible, draw smaller form errors for its stage.

    Returns:
        The scene, the sizes and the visibility of the effect; None if it remains hidden.
    """
    low, high = STANDS_OUT
    target = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    drawn = [draw_effect(name, rng, rig_file(scene.rig)) for _ in range(CANDIDATES)]
    found = [(scene.prominence({name: sizes}), sizes) for sizes in drawn]
    fit = [(s, sizes) for s, sizes in found if max(s.visibility.values()) >= low]
    if fit:
        s, sizes = min(fit, key=lambda pair: abs(np.log(max(pair[0].visibility.values()) / target)))
        return scene, sizes, s
    s, sizes = max(found, key=lambda pair: max(pair[0].visibility.values()))
    stage = max(s.visibility, key=s.visibility.__getitem__)
    # Against form errors alone, visibility is inversely proportional to them.
    smaller = 0.9 * s.visibility[stage] / low
    if scene.forms.sizes[stage] * smaller < LEAST_FORM:
        smaller = LEAST_FORM / scene.forms.sizes[stage]
    if smaller >= 1.0:
        return None
    scene = scene.with_forms(scene.forms.shrunk(stage, smaller))
    s = scene.prominence({name: sizes})
    return (scene, sizes, s) if max(s.visibility.values()) >= low else None


def _imperfect(
    rng: Rng,
    rig: str,
    name: str | None,
    duration: float,
    day: Day | None,
    weight: float,
    healthy: Sequence[tuple[str, int]] = (),
) -> tuple[Any, ...]:
    """Draw rig, experiment and size until the effect is visible; return them, its visibility, and the rejected draws.

    The form errors are of the size drawn in the first healthy recording, or in the recording itself if there is none.
    """
    for redrawn in range(MOST_DRAWS):
        experiment, seed = _experiment(rng, name, experiments_of(rig_file(rig))), _seed(rng)
        first, first_seed = healthy[0] if healthy else (experiment, seed)
        forms = draw_forms(rng, rig_file(rig), first, seed=first_seed, duration=duration)
        if name is None:
            return forms, experiment, seed, {}, None, redrawn
        found = _sized(rng, name, _Scene(rig, forms, day, weight, (experiment, seed, duration)))
        if found is not None:
            scene, sizes, s = found
            return scene.forms, experiment, seed, {name: sizes}, s, redrawn
    raise RuntimeError(f"{name}: stands out of no rig in {MOST_DRAWS} draws")


def _case(kind: str, seed: int, number: int, duration: float, drawn: tuple[Any, ...], exam: str, **more: Any) -> Case:
    forms, experiment, record_seed, hidden, s, redrawn = drawn
    seen = {} if s is None else {name: {stage: round(v, 3) for stage, v in s.visibility.items()} for name in hidden}
    share = None if s is None else round(s.share, 4)
    return Case(
        seed, number, kind, experiment, record_seed, duration, hidden, seen, redrawn, exam, forms=forms, share=share, **more
    )  # fmt: skip


def make_partial(seed: int, number: int, duration: float, rig: str = "paper") -> Case:
    """Draw a case of the exam `partial`."""
    rng = np.random.default_rng([seed, number, 1])
    drawn = _imperfect(rng, rig, effect_of(seed, number, rig), duration, None, 1.0)
    how = draw_measurement(rng, (), jitter=float(rng.uniform(0.0, JITTER)))
    return _case("singles", seed, number, duration, drawn, name_of("partial", rig), measurement=how, rig=rig)


def make_baseline(seed: int, number: int, duration: float, rig: str = "paper") -> Case:
    """Draw a case of the exam `baseline`: one healthy recording of the same day, or three of other days."""
    rng = np.random.default_rng([seed, number, 2])
    kind = _alternating(number)
    name = effect_of(seed, number // 2, rig) if kind == "singles" else None
    count = int(rng.choice([1, 3]))
    days = tuple(draw_day(rng, SPREAD) for _ in range(1 + count)) if count > 1 else ()
    healthy = tuple((_experiment(rng, name, HEALTHY), _seed(rng)) for _ in range(count))
    drawn = _imperfect(rng, rig, name, duration, days[0] if days else None, REMEMBERED, healthy)
    how = draw_measurement(rng, (), jitter=float(rng.uniform(0.0, JITTER)))
    exam = name_of("baseline", rig)
    return _case(kind, seed, number, duration, drawn, exam, measurement=how, healthy=healthy, days=days, rig=rig)


# ------------------------------------------------------------------------------------------------------- skewed channels


def make_skew(seed: int, number: int, duration: float) -> Case:
    """Draw a case of the exam `skew`: each experiment with and without disturbance, with and without an effect, in turn."""
    rng = np.random.default_rng([seed, number, 3])
    kind = _alternating(number)
    name = effect_of(seed, number // 2) if kind == "singles" else None
    turn = number // 2
    disturbed = turn // len(SKEW_EXPERIMENTS) % 2 == 0
    experiment = "servo" if name == "coupling_stiffness" else SKEW_EXPERIMENTS[turn % len(SKEW_EXPERIMENTS)]
    hidden: dict[str, dict[str, Any]] = {}
    seen: dict[str, dict[str, float]] = {}
    record_seed, redrawn = _seed(rng), 0
    while name is not None:
        hidden = {name: draw_effect(name, rng, rig_file())}
        without = background(rig_file(), experiment, seed=record_seed, duration=duration, disturbed=disturbed)
        alone = record(rig_file(), hidden, experiment, seed=record_seed, duration=duration, disturbed=disturbed, noise=0.0)
        seen = {name: {stage: round(value, 3) for stage, value in against(without, rig_file(), alone).items()}}
        told_from_skew = name not in LATE or hidden[name]["delay"] >= LEAST_DELAY
        if (told_from_skew and max(seen[name].values()) >= SHOWS) or redrawn >= MOST_DRAWS:
            break
        record_seed, redrawn = _seed(rng), redrawn + 1
    columns = record(rig_file(), hidden, experiment, seed=record_seed, duration=0.01).columns
    how = draw_measurement(rng, columns, skew=1.0, jitter=JITTER)
    return Case(
        seed, number, kind, experiment, record_seed, duration, hidden, seen, redrawn, "skew", measurement=how,
        disturbed=disturbed,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------------- other forms


def _with_pairs(number: int) -> str:
    return ("singles", "pairs")[number % 2]


def make_forms(seed: int, number: int, duration: float) -> Case:
    """Draw a case of the exam `forms`: all formulas equally often, every other one beside an effect in its usual form."""
    rng = np.random.default_rng([seed, number, 4])
    kind = _with_pairs(number)
    pool = sorted((name, form) for name, of in OTHER_FORMS.items() for form in of)
    turn, place = divmod(number // 2, len(pool))
    name, form = pool[int(np.random.default_rng([seed, turn, number % 2, 17]).permutation(len(pool))[place])]
    others = [other for other in sorted(LISTED) if other != name and {other, name} != ONE_BODY]
    beside = [str(rng.choice(others))] if kind == "pairs" else []

    def draw() -> Hidden:
        usual = {other: draw_effect(other, rng, rig_file()) for other in beside}
        return {name: draw_other_form(name, form, rng, rig_file()), **usual}

    return shown(rng, seed, number, kind, duration, draw)._replace(exam="forms")


# ------------------------------------------------------------------------------------------------------- raw data of rigs


def make_raw(seed: int, number: int, duration: float) -> Case:
    """Draw a case of the exam `raw`; if its data do not show the effect in some draws, draw another effect."""
    rng = np.random.default_rng([seed, number, 4])
    data = list(raw.KINDS)[number % len(raw.KINDS)]
    name = effect_of(seed, number)
    for redrawn in range(MOST_DRAWS):
        experiment, record_seed = _experiment(rng, name), _seed(rng)
        hidden = {name: draw_effect(name, rng, rig_file())}
        seen = raw.visible(data, hidden, experiment, record_seed, duration)
        if max(seen.values()) >= SHOWS:
            rounded = {name: {stage: round(value, 3) for stage, value in seen.items()}}
            return Case(seed, number, "singles", experiment, record_seed, duration, hidden, rounded, redrawn, "raw", data=data)
        if redrawn % DRAWS_OF_ONE == DRAWS_OF_ONE - 1:
            name = str(rng.choice(sorted(LISTED)))
    raise RuntimeError(f"{data}: no effect shows in {MOST_DRAWS} draws")


# ------------------------------------------------------------------------------------------------------- neighbouring effects


def make_neighbours(seed: int, number: int, duration: float) -> Case:
    """Draw a case of the exam `neighbours`; other effects are drawn until their stages are equal or adjacent."""
    rng = np.random.default_rng([seed, number, 5])
    while True:
        pair = tuple(str(name) for name in rng.choice(sorted(LISTED), 2, replace=False))
        if set(pair) == ONE_BODY:
            continue
        case = shown(rng, seed, number, "pairs", duration, lambda: {name: draw_effect(name, rng, rig_file()) for name in pair})  # noqa: B023
        one, other = (CHAIN.index(max(stages, key=stages.__getitem__)) for stages in case.visibility.values())
        if abs(one - other) <= 1:
            return case._replace(exam="neighbours")


EXAMS: dict[str, Exam] = {
    "clean": Exam(cases.KINDS, cases.kind_of, cases.make),
    "partial": Exam(("singles",), lambda number: "singles", make_partial),
    "baseline": Exam(("singles", "nothing"), _alternating, make_baseline),
    "skew": Exam(("singles", "nothing"), _alternating, make_skew),
    "forms": Exam(("singles", "pairs"), _with_pairs, make_forms),
    "raw": Exam(("singles",), lambda number: "singles", make_raw),
    "neighbours": Exam(("pairs",), lambda number: "pairs", make_neighbours),
}
EXAMS |= {
    name_of("clean", "single_rod"): EXAMS["clean"]._replace(make=partial(cases.make, rig="single_rod")),
    name_of("partial", "single_rod"): EXAMS["partial"]._replace(make=partial(make_partial, rig="single_rod")),
    name_of("baseline", "single_rod"): EXAMS["baseline"]._replace(make=partial(make_baseline, rig="single_rod")),
    name_of("one_pressure", "single_rod"): Exam(("singles",), lambda number: "singles", single_rod.make_one_pressure),
}


def numbers(exam: str, count: int, only: str | None) -> list[int]:
    """Return the numbers of the first cases, optionally of one kind only."""
    found, number = list[int](), 0
    while len(found) < count:
        if only is None or EXAMS[exam].kind_of(number) == only:
            found.append(number)
        number += 1
    return found
