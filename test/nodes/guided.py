"""Sequences of attacks, guided by the distance of earlier ones from violating a policy.

After PGFuzz (Kim et al., NDSS 2021): a sequence that came closer to violating some policy than those before is kept, and
mutated to come closer still; the policies take turns. Without such feedback, attacks are drawn blindly.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

LENGTH = 8
"""Number of actions of a new sequence."""

LONGEST = 12
"""Maximum number of actions of a mutated sequence."""

KEPT = 6
"""Sequences kept for each policy."""

FRESH = 0.2
"""Fraction of sequences that are drawn anew although there is one to mutate."""

PAUSES = (0.0, 1.0, 2.0, 5.0, 20.0, 60.0)
"""Times between two actions, in control periods."""


class Action(NamedTuple):
    """An action, with the time to wait after it [control periods]."""

    name: str
    arguments: tuple[Any, ...] = ()
    pause: float = 0.0

    def __str__(self) -> str:
        """Return it as a call."""
        return f"{self.name}({', '.join(map(str, self.arguments))})"


Attack = tuple[Action, ...]
"""A sequence of actions."""


class Kind(NamedTuple):
    """A kind of action: its relative frequency, and the draw of its arguments."""

    weight: float
    draw: Callable[[Random], tuple[Any, ...]] = lambda _: ()


class Kept(NamedTuple):
    """A sequence with the smallest robustness of a policy in it."""

    robustness: float
    attack: Attack


class Search:
    """Draws and mutates sequences.

    Attributes:
        closest: for each policy, the sequences that came closest to violating it, the closest first.
        origins: number of sequences by origin.
    """

    def __init__(self, random: Random, kinds: Mapping[str, Kind], *, blind: bool = False) -> None:
        """Start without feedback.

        Args:
            random: source of all choices.
            kinds: the actions by name.
            blind: whether to draw all sequences anew.
        """
        self._random = random
        self._kinds = kinds
        self._blind = blind
        self._turn = 0
        self._drawn = 0
        self.closest: dict[str, list[Kept]] = {}
        self._farthest: dict[str, float] = {}
        self.origins: Counter[str] = Counter()

    def next(self) -> Attack:
        """Return the next sequence."""
        policy = self._policy()
        if self._blind or policy is None or self._random.random() < FRESH:
            self.origins["fresh"] += 1
            return self._fresh()
        self.origins[policy] += 1
        kept = self.closest[policy]
        # The closest most often.
        parent = kept[min(int(self._random.expovariate(1.0)), len(kept) - 1)].attack
        return self._changed(parent)

    def learn(self, attack: Attack, robustness: Mapping[str, float]) -> None:
        """Record how close a sequence came to violating each policy evaluated in it."""
        for policy, value in robustness.items():
            if not math.isfinite(value):
                continue
            kept = self.closest.setdefault(policy, [])
            self._farthest[policy] = max(value, self._farthest.get(policy, value))
            # Of equally close ones the last: further progress may be possible from it.
            if len(kept) < KEPT or value <= kept[-1].robustness:
                kept.insert(0, Kept(value, attack))
                kept.sort(key=lambda entry: entry.robustness)
                del kept[KEPT:]

    def _policy(self) -> str | None:
        """Return the policy to target, in turn: one whose robustness depends on the sequence."""
        graded = [name for name, kept in sorted(self.closest.items()) if kept[0].robustness < self._farthest[name]]
        if not graded:
            return None
        self._turn += 1
        return graded[self._turn % len(graded)]

    def _fresh(self) -> Attack:
        """Draw a sequence; each kind of action is the first in turn, in an undisturbed state."""
        names = list(self._kinds)
        self._drawn += 1
        return (self._of(names[self._drawn % len(names)]), *(self._draw() for _ in range(LENGTH - 1)))

    def _draw(self) -> Action:
        names = list(self._kinds)
        [name] = self._random.choices(names, [self._kinds[name].weight for name in names])
        return self._of(name)

    def _of(self, name: str) -> Action:
        return Action(name, self._kinds[name].draw(self._random), self._random.choice(PAUSES))

    def _changed(self, attack: Attack) -> Attack:
        """Return a sequence with one or two changes: of actions, order, timing or arguments."""
        actions = list(attack)
        for _ in range(self._random.choice([1, 1, 2])):
            change = self._random.choice([self._replace, self._insert, self._remove, self._swap, self._retime, self._vary])
            change(actions)
        if self._random.random() < 0.2:
            actions = self._joined(actions)
        return tuple(actions[:LONGEST])

    def _place(self, actions: Sequence[Action]) -> int:
        return self._random.randrange(len(actions))

    def _replace(self, actions: list[Action]) -> None:
        actions[self._place(actions)] = self._draw()

    def _insert(self, actions: list[Action]) -> None:
        actions.insert(self._place(actions), self._draw())

    def _remove(self, actions: list[Action]) -> None:
        if len(actions) > 1:
            del actions[self._place(actions)]

    def _swap(self, actions: list[Action]) -> None:
        one, other = self._place(actions), self._place(actions)
        actions[one], actions[other] = actions[other], actions[one]

    def _retime(self, actions: list[Action]) -> None:
        place = self._place(actions)
        longer = actions[place].pause * self._random.choice([0.5, 0.8, 1.25, 2.0]) + self._random.choice([0.0, 1.0])
        actions[place] = actions[place]._replace(pause=min(longer, 2.0 * PAUSES[-1]))

    def _vary(self, actions: list[Action]) -> None:
        place = self._place(actions)
        actions[place] = self._of(actions[place].name)._replace(pause=actions[place].pause)

    def _joined(self, actions: list[Action]) -> list[Action]:
        """Return the beginning of a sequence joined with the end of another kept one."""
        other = self._random.choice([kept.attack for name in sorted(self.closest) for kept in self.closest[name]])
        return [*actions[: 1 + self._place(actions)], *other[self._random.randrange(len(other)) :]]
