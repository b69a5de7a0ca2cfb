"""Input streams of the monitor: hours of a healthy rig, and rigs in which an effect begins or grows while they run.

The streams come from truth_generator, which shares no code with ehls_ros. They depend only on the run's seed and their number.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.diagnosis.cases import Hidden, rig, rig_file
from ehls_ros.arrays import Array
from ehls_ros.physics.effects import EFFECTS as KNOWN
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.trajectory import Trajectory
from truth_generator import COLUMNS, SERVO_COLUMNS, Day, FormErrors, draw_forms, record

Rng = np.random.Generator

FORCE = {"rich": 0.3, "random": 0.25, "steps": 0.15, "paper_sine": 0.1, "paper_constant": 0.1, "servo": 0.1}
"""Probability of each programme under force control."""

POSITION = {"slow_sweep": 0.6, "presliding": 0.1, "rest": 0.2, "tiny": 0.1}
"""Probability of each programme under position control."""

IN_FORCE = 0.75
"""Part of the stretches that are under force control."""

STRETCH, PROGRAMME = 180.0, 60.0
"""Length of a stretch, which is one run of the truth generator, and of each programme in it [s]."""

PAUSE = 10.0
"""Time between two stretches, which is not recorded [s]."""

WARMER, WARMING_TIME = (5.0, 25.0), 1200.0
"""Rise of the oil temperature in an episode [K], and its time constant [s]."""

PER_KELVIN = (0.005, 0.02)
"""Fraction of the viscous friction that a warm rig loses per kelvin, as stated in its file."""

SHARED = (*COLUMNS, *SERVO_COLUMNS)


class Stretch(NamedTuple):
    """One run of the truth generator.

    Attributes:
        begin: its first time on the monitor's axis [s].
        programmes: programmes in turn.
        seed: its seed.
        duration: its duration [s].
        day: condition of the rig.
        effects: effects that are in the rig file.
    """

    begin: float
    programmes: tuple[str, ...]
    seed: int
    duration: float
    day: Day
    effects: Hidden


class Episode(NamedTuple):
    """Operating time of a healthy rig.

    Attributes:
        number: number in the run.
        kind: ``exact`` or ``warm``: the rig's friction depends on the oil's temperature, as stated in its file.
        rig: the rig that the monitor is given.
        forms: how the rig differs from every model; None if it does not.
        stretches: its stretches in order.
    """

    number: int
    kind: str
    rig: Rig
    forms: FormErrors | None
    stretches: tuple[Stretch, ...]


def _drawn(rng: Rng, among: Mapping[str, float]) -> str:
    return str(rng.choice(list(among), p=list(among.values())))


def _programmes(rng: Rng, count: int) -> tuple[str, ...]:
    among = FORCE if rng.random() < IN_FORCE else POSITION
    return tuple(_drawn(rng, among) for _ in range(count))


def episode(seed: int, number: int, duration: float, form: float | None) -> Episode:
    """Draw an episode.

    Args:
        seed: of the run.
        number: number of the episode.
        duration: its duration [s].
        form: size of the rig's form errors, as a fraction of the largest terms; None for a rig that is its model.
    """
    rng = np.random.default_rng([seed, number, 20])
    kind = ("exact", "warm")[number % 2]
    warmer, slope = float(rng.uniform(*WARMER)), float(rng.uniform(*PER_KELVIN))
    forms = None if form is None else draw_forms(rng, rig_file(), smallest=0.5 * form, largest=form)
    stretches = list[Stretch]()
    begin = 0.0
    while begin < duration:
        programmes = _programmes(rng, round(STRETCH / PROGRAMME))
        # The monitor learns from the first minute: a rig is set up on a programme that moves it.
        programmes = ("rich", *(_drawn(rng, FORCE) for _ in programmes[1:])) if not stretches else programmes
        now, later = (warmer * (1.0 - np.exp(-t / WARMING_TIME)) for t in (begin, begin + STRETCH))
        sizes = {"form": "linear", "coefficient": slope, "warming": float(later - now), "time_constant": STRETCH}
        effects = {"temperature_dependent_friction": sizes} if kind == "warm" else {}
        day = Day(warmer=float(now))
        stretches.append(Stretch(begin, programmes, int(rng.integers(2**31)), STRETCH, day, effects))
        begin += STRETCH + PAUSE
    return Episode(number, kind, _knowing(slope) if kind == "warm" else rig(), forms, tuple(stretches))


def _knowing(slope: float) -> Rig:
    """Return the rig whose file states the decrease of its viscous friction with the oil temperature."""
    name = "temperature_dependent_friction"
    given = rig()
    parameters = KNOWN.load(name).Parameters(viscous_slope=-slope * given.friction.viscous_coefficient)
    return given._replace(effects=(EffectUse(name, parameters),))


def stretches_of(of: Episode) -> Iterator[Trajectory]:
    """Yield the recordings of an episode, on the monitor's axis."""
    for s in of.stretches:
        r = record(
            rig_file(), s.effects, "+".join(s.programmes), seed=s.seed, duration=s.duration, columns=SHARED, forms=of.forms,
            day=s.day,
        )  # fmt: skip
        yield Trajectory(r.time + s.begin, r.columns)


class Onset(NamedTuple):
    """A rig in which an effect begins while it runs.

    Attributes:
        experiment: name of the experiment.
        seed: seed of the recording.
        duration: its duration [s].
        growth: sizes of the effect, each from a time on.
    """

    experiment: str
    seed: int
    duration: float
    growth: Sequence[tuple[float, Hidden]]


def recording_of(of: Onset) -> Trajectory:
    """Return the recording of a rig in which an effect begins."""
    r = record(rig_file(), {}, of.experiment, seed=of.seed, duration=of.duration, columns=SHARED, growth=of.growth)
    return Trajectory(r.time, r.columns)


def part(of: Trajectory, begin: float, end: float) -> Trajectory:
    """Return a part of a recording, beginning at 0."""
    first, last = np.searchsorted(of.time_s, [begin, end])
    return Trajectory(of.time_s[first:last] - of.time_s[first], {name: v[first:last] for name, v in of.signals.items()})


def in_chunks(of: Trajectory, seconds: float = 0.5) -> Iterator[tuple[Array, dict[str, Array]]]:
    """Yield a recording in chunks, as messages deliver it."""
    edges = np.searchsorted(of.time_s, np.arange(of.time_s[0], of.time_s[-1] + seconds, seconds))
    for first, last in zip(edges, [*edges[1:], len(of.time_s)], strict=True):
        if last > first:
            yield of.time_s[first:last], {name: values[first:last] for name, values in of.signals.items()}
