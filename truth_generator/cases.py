"""Cases drawn by a seed and a number: the effects hidden in them, their sizes, and the experiment in which they show.

A case depends only on the seed of the run and its number, not on the number of cases.
"""

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from .effects import draw_effect, is_single, listed_of, outside_of
from .recording import record
from .visibility import against, background

KINDS = ("singles", "pairs", "nothing", "outside")
ORDER = "sopsnsosnspsosnspsop"
"""Kinds of twenty consecutive cases by their first letters: 45 % singles, 20 % pairs, 15 % nothing, 20 % outside the list."""

EXPERIMENTS = {"rich": 0.45, "random": 0.3, "steps": 0.1, "paper_sine": 0.1, "servo": 0.05}
"""Probability of each experiment on a double rod; a single rod has no experiment with a position servo."""

SHOWS = 1.3
"""Minimum visibility of an effect in the experiment drawn; below it, size and experiment are drawn again."""

MOST_DRAWS = 40
"""Maximum number of draws of size and experiment for one case."""

ONE_BODY = {"hinge_backlash", "flexible_mode"}
"""Effects that cannot be combined."""

REFUSED = {"swapped_pressure_sensors"}
"""Effects with which a recording cannot be diagnosed: they occur only alone."""

Hidden = dict[str, dict[str, Any]]
"""Sizes of hidden effects by name."""


class Drawn(NamedTuple):
    """What is drawn for a case.

    Attributes:
        experiment: name of the experiment.
        record_seed: seed of the recording.
        hidden: sizes by effect.
        visibility: visibility of each effect alone, by stage.
        redrawn: draws that were rejected because an effect would not have shown.
    """

    experiment: str
    record_seed: int
    hidden: Hidden
    visibility: dict[str, dict[str, float]]
    redrawn: int


def kind_of(number: int) -> str:
    """Return the kind of a case."""
    return {kind[0]: kind for kind in KINDS}[ORDER[number % len(ORDER)]]


def experiments_of(rig: Mapping[str, Any]) -> dict[str, float]:
    """Return the probability of each experiment on a rig."""
    if not is_single(rig):
        return EXPERIMENTS
    left = {name: share for name, share in EXPERIMENTS.items() if name != "servo"}
    return {name: share / sum(left.values()) for name, share in left.items()}


def names_of(rig: Mapping[str, Any], seed: int, number: int) -> tuple[str, ...]:
    """Return the effects hidden in a case: all equally often, in an order given by the seed."""
    listed = listed_of(rig)
    kind = kind_of(number)
    if kind == "nothing":
        return ()
    before = sum(kind_of(n) == kind for n in range(number))
    if kind == "pairs":
        fair = [pair for pair in combinations(sorted(set(listed) - REFUSED), 2) if set(pair) != ONE_BODY]
        return fair[int(np.random.default_rng([seed, number, 7]).integers(len(fair)))]
    pool = sorted(listed if kind == "singles" else outside_of(rig))
    turn, place = divmod(before, len(pool))
    order = np.random.default_rng([seed, turn, KINDS.index(kind)]).permutation(len(pool))
    return (pool[int(order[place])],)


def draw_case(rig: Mapping[str, Any], seed: int, number: int, duration: float) -> Drawn:
    """Draw a case of a rig that is the model, apart from the hidden effects."""
    rng = np.random.default_rng([seed, number])
    names = names_of(rig, seed, number)
    return draw_shown(rig, rng, duration, lambda: {name: draw_effect(name, rng, rig) for name in names})


def draw_shown(rig: Mapping[str, Any], rng: np.random.Generator, duration: float, draw: Callable[[], Hidden]) -> Drawn:
    """Draw experiment and hidden effects until all of them show.

    Args:
        rig: content of the rig file.
        rng: random number generator, which `draw` uses too.
        duration: duration of the recording [s].
        draw: draws the hidden effects.
    """
    redrawn, among = 0, experiments_of(rig)
    while True:
        experiment = str(rng.choice(list(among), p=list(among.values())))
        record_seed = int(rng.integers(2**31))
        hidden = draw()
        if "coupling_stiffness" in hidden:
            experiment = "servo"
        seen: dict[str, dict[str, float]] = {}
        if hidden:
            without = background(rig, experiment, seed=record_seed, duration=duration)
        for name, sizes in hidden.items():
            alone = record(rig, {name: sizes}, experiment, seed=record_seed, duration=duration, noise=0.0)
            seen[name] = {stage: round(value, 3) for stage, value in against(without, rig, alone).items()}
        if all(max(stages.values()) >= SHOWS for stages in seen.values()) or redrawn >= MOST_DRAWS:
            return Drawn(experiment, record_seed, hidden, seen, redrawn)
        redrawn += 1
